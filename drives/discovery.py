"""Check which of the configured drives respond, whether each node id is unique, and whether the identity matches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from drives.bus import Bus
from drives.drive import Cia402Drive
from drives.errors import DuplicateNode, NodeMissing
from drives.heartbeat import HeartbeatWatch, NmtCommand, NmtState, send_nmt
from drives.probe import QUESTIONS, probe
from drives.values import Identity

#: Longest wait for nodes that did not answer the first request.
_PATIENCE_S: Final = 1.0
#: Longer than the heartbeat period that most devices come with.
LISTEN_S: Final = 1.2


def count_answers(bus: Bus, node_ids: Iterable[int], timeout_s: float) -> dict[int, int]:
    """Count the devices that respond at each node id within a time [s]; repeated requests wait longer.

    A node that does not answer may be in NMT state STOPPED: it gets the command to leave it and a second request. Two
    answers are requested again too, because a frame may have been duplicated on the bus.
    """
    answers = probe(bus, node_ids, timeout_s)
    again = [node_id for node_id, number in answers.items() if number != 1]
    for node_id in again:
        if answers[node_id] == 0:
            send_nmt(bus, NmtCommand.ENTER_PREOPERATIONAL, node_id)
    patience_s = max(timeout_s, _PATIENCE_S)
    return answers | probe(bus, again, patience_s, QUESTIONS[1]) if again else answers


def nmt_states(bus: Bus, node_ids: Iterable[int], listen_s: float = LISTEN_S) -> dict[int, NmtState | None]:
    """Return the NMT state of nodes from their heartbeats; None = no heartbeat received. Nothing is sent.

    Parameters
    ----------
    bus : Bus
    node_ids : iterable of int
    listen_s : float
        How long to listen.
    """
    wanted = tuple(node_ids)
    watch = HeartbeatWatch(bus, wanted, [None] * len(wanted))
    try:
        if wanted:
            bus.listen(listen_s)
        return dict(watch.states)
    finally:
        watch.close()


def missing(node_id: int, state: NmtState | None) -> NodeMissing:
    """Return the error for a node that does not answer SDO, with the NMT state of its heartbeat."""
    if state is None:
        return NodeMissing("no device answers", node=node_id, advice="check power, node id, bit rate and cabling")
    if state is NmtState.STOPPED:
        what = "is in NMT state STOPPED, in which SDO is not available"
        advice = (
            f"send the NMT command PRE-OPERATIONAL (CAN id 000, data 80 {node_id:02X}), or switch the drive off and on"
        )
        return NodeMissing(what, node=node_id, advice=advice)
    what = f"does not respond to SDO requests, although its heartbeat reports {str(state).upper()}"
    return NodeMissing(what, node=node_id, advice="another tool may use its SDO channel; if not, power-cycle it")


def require_one(node_id: int, answers: int, state: NmtState | None = None) -> None:
    """Make sure that one device answers at a node id; `state` is the NMT state of its heartbeat, if one was received.

    Raises
    ------
    NodeMissing, DuplicateNode
    """
    if answers == 0:
        raise missing(node_id, state)
    if answers > 1:
        advice = "give each drive its own node id"
        raise DuplicateNode(f"{answers} devices answer at this node id", node=node_id, advice=advice)


def identify(drive: Cia402Drive, answers: int, state: NmtState | None = None) -> Identity:
    """Read the identity of a drive and compare it with its profile.

    Raises
    ------
    NodeMissing, DuplicateNode, IdentityMismatch
    """
    require_one(drive.node_id, answers, state)
    return drive.identify()
