"""Errors in words: short, the cause first, nothing said twice."""

from __future__ import annotations

import textwrap

from drives.errors import BusError, DriveError, DriveFault, SdoTimeout, SeveralFailures, TransitionTimeout

ADVICE = "check power, node id, bit rate and that the node is not in NMT state STOPPED"


def timeouts(*nodes: int) -> list[DriveError]:
    return [SdoTimeout("no SDO answer within 300 ms", node=node, index=0x6041, advice=ADVICE) for node in nodes]


def test_what_all_nodes_say_is_said_once():
    text = str(SeveralFailures(timeouts(1, 2, 3, 4, 5, 6)))
    assert text == f"nodes 1 to 6:6041:00 (statusword): no SDO answer within 300 ms; {ADVICE}"


def test_nodes_with_gaps_are_listed():
    assert str(SeveralFailures(timeouts(5, 2, 1))).startswith("nodes 1, 2, 5:6041:00")


def test_different_failures_are_numbered_in_their_order():
    failures = [TransitionTimeout("stays", node=3, index=0x6041), *timeouts(1, 2)]
    text = str(SeveralFailures(failures))
    assert text.startswith("3 failures: (1) node 3:6041:00 (statusword): stays; (2) nodes 1, 2:6041:00")


def test_what_was_said_is_not_repeated_while_stopping():
    error = SeveralFailures(timeouts(1, 2, 3))
    error.while_stopping = tuple(timeouts(1, 2, 3))
    assert "while stopping" not in str(error)
    error.while_stopping = (SeveralFailures(timeouts(1, 2, 3, 4)),)
    assert str(error).count("no SDO answer") == 2
    assert "while stopping: node 4:" in str(error)


def test_a_bus_that_fails_is_reported_in_ten_lines_with_the_cause_first():
    """The bus fails, then every node in every mode while stopping, disabling and disarming."""
    error = BusError(
        "frame 201 could not be sent within 20 ms: Transmit buffer full", advice="check that the bus is up"
    )
    sent = [BusError(f"frame 60{node} could not be sent within 20 ms: full", advice="bus up?") for node in range(1, 7)]
    error.while_stopping = (
        *sent,
        *timeouts(1, 2, 3, 4, 5, 6),
        *(DriveFault(f"left OPERATION ENABLED: reason {node}", node=node, advice="find it") for node in range(1, 7)),
    )
    lines = textwrap.wrap(str(error), 100)
    assert len(lines) <= 10
    assert lines[0].startswith("frame 201 could not be sent")
    assert "and 8 more" in str(error)


def test_every_failure_stays_to_be_asked_for():
    error = SeveralFailures(timeouts(1, 2))
    assert [failure.node for failure in error.failures] == [1, 2]
