"""Who of the drives that are wanted is there, and whether each is alone and the right one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from drives.bus import Bus
from drives.drive import Cia402Drive
from drives.errors import DuplicateNode, NodeMissing
from drives.heartbeat import HeartbeatWatch, NmtCommand, NmtState, send_nmt
from drives.probe import QUESTIONS, probe
from drives.values import Identity

#: Longest wait for whoever did not answer the first question.
_PATIENCE_S: Final = 1.0


def count_answers(bus: Bus, node_ids: Iterable[int], timeout_s: float) -> dict[int, int]:
    """How many devices answer at each node id within a time [s], longer for those asked again.

    Whoever does not answer may be in NMT state STOPPED: it is told to leave it, and asked again. Two answers are asked
    for again too, since a frame may have been doubled on its way.
    """
    answers = probe(bus, node_ids, timeout_s)
    again = [node_id for node_id, number in answers.items() if number != 1]
    for node_id in again:
        if answers[node_id] == 0:
            send_nmt(bus, NmtCommand.ENTER_PREOPERATIONAL, node_id)
    patience_s = max(timeout_s, _PATIENCE_S)
    return answers | probe(bus, again, patience_s, QUESTIONS[1]) if again else answers


def require_one(node_id: int, answers: int) -> None:
    """Make sure that one device answers at a node id.

    Raises
    ------
    NodeMissing, DuplicateNode
    """
    if answers == 0:
        advice = "check power, node id, bit rate and cabling"
        raise NodeMissing("nobody answers", node=node_id, advice=advice)
    if answers > 1:
        advice = "give each drive its own node id"
        raise DuplicateNode(f"{answers} devices answer at this node id", node=node_id, advice=advice)


def identify(drive: Cia402Drive, answers: int) -> Identity:
    """Read who a drive is and compare it with its profile.

    Raises
    ------
    NodeMissing, DuplicateNode, IdentityMismatch
    """
    require_one(drive.node_id, answers)
    return drive.identify()


def nmt_states(bus: Bus, node_ids: Iterable[int], listen_s: float) -> dict[int, NmtState | None]:
    """NMT state of each node as its heartbeat shows it within a time [s]; None = none was heard. Nothing is sent."""
    wanted = tuple(node_ids)
    watch = HeartbeatWatch(bus, wanted, [None] * len(wanted))
    try:
        bus.listen(listen_s)
        return dict(watch.states)
    finally:
        watch.close()
