"""Who is on the bus: other masters, nodes by one SDO request each, NMT states by heartbeat, identity of each node."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from drives.bus import HEARTBEAT_BASE, NMT_ID, SDO_ANSWER_BASE, SDO_REQUEST_BASE, SYNC_ID, Bus
from drives.errors import DriveError, DuplicateNode, ForeignMaster, NodeMissing, SdoAbort, SdoProtocolError
from drives.heartbeat import MASTER_NODE_ID, HeartbeatWatch, NmtCommand, NmtState, send_nmt
from drives.objects import OBJECTS
from drives.profile_file import GENERIC, list_profiles, load_profile
from drives.sdo import SdoClient
from drives.values import Identity

#: A bus on which no master has sent for so long [s] is free: longer than SYNC periods and heartbeats of masters.
FREE_S: Final = 0.5
_MASTER_ONLY: Final = ((SYNC_ID, "SYNC"), (NMT_ID, "NMT commands"))


def refuse_foreign(bus: Bus, listen_s: float = FREE_S) -> None:
    """Refuse a bus on which another master is active; nothing is sent. Afterwards `Bus.check_free` monitors the bus.

    Parameters
    ----------
    bus : Bus
    listen_s : float
        How long to listen.

    Raises
    ------
    ForeignMaster
        Another master sends SYNC, NMT commands, SDO requests, or a heartbeat with the node id of a master.
    """
    beats = 0

    def on_beat(_can_id: int, data: bytes | bytearray, _time_s: float) -> None:
        nonlocal beats
        beats += len(data) == 1

    bus.drain()
    before = dict(bus.foreign)
    bus.subscribe(HEARTBEAT_BASE + MASTER_NODE_ID, on_beat)
    try:
        bus.listen(listen_s)
    finally:
        bus.unsubscribe(HEARTBEAT_BASE + MASTER_NODE_ID, on_beat)
    new = {can_id: number - before.get(can_id, 0) for can_id, number in bus.foreign.items()}
    sent = _sent_by_master(new)
    advice = "end the other master, or wait until it has ended, then start again"
    if beats and not sent:
        advice += f"; if node {MASTER_NODE_ID} is a drive, give it another id: masters have this one"
    sent += [f"the heartbeat of node {MASTER_NODE_ID}"] * bool(beats)
    if sent:
        what = f"another master is active on {bus.spec}: in {listen_s:g} s it has sent {' and '.join(sent)}"
        raise ForeignMaster(f"{what}; nothing was sent to the drives", advice=advice)
    bus.free_count = bus.foreign_count


def _sent_by_master(frames: Mapping[int, int]) -> list[str]:
    """Describe the frames of a master, counted by CAN id."""
    sent = [f"{frames[can_id]} {what}" for can_id, what in _MASTER_ONLY if frames.get(can_id)]
    asked = [can_id - SDO_REQUEST_BASE for can_id in sorted(frames) if can_id > SDO_REQUEST_BASE and frames[can_id]]
    if asked:
        sent.append(f"SDO requests to node{'s' * (len(asked) > 1)} {', '.join(map(str, asked))}")
    return sent


#: Uploads that every CANopen device supports: device type, vendor id. A repeated request uses the other one, so that a
#: delayed answer to the first request does not count as a second device.
QUESTIONS: Final = (bytes.fromhex("4000100000000000"), bytes.fromhex("4018100100000000"))
#: After the last answer: how long a second device with the same id may still take.
_QUIET_S: Final = 0.05
_PAUSE_EVERY: Final = 16
#: Longest wait for nodes that did not answer the first request.
_PATIENCE_S: Final = 1.0
#: Longer than the heartbeat period that most devices come with.
LISTEN_S: Final = 1.2
#: Value of object 0x5FFE of a simulated node.
SIMULATOR_NAME: Final = "servo-sim"


def probe(bus: Bus, node_ids: Iterable[int], timeout_s: float = 0.3, question: bytes = QUESTIONS[0]) -> dict[int, int]:
    """Send one SDO request for a mandatory object to every node and count the responses.

    Parameters
    ----------
    bus : Bus
    node_ids : iterable of int
    timeout_s : float
        Longest wait for those that do not answer.
    question : bytes
        One of `QUESTIONS`.

    Returns
    -------
    dict
        Node id -> number of answers; more than one means more than one device.
    """
    answers = dict.fromkeys(node_ids, 0)
    last_s = 0.0

    def on_answer(can_id: int, data: bytes | bytearray, time_s: float) -> None:
        nonlocal last_s
        if len(data) == 8 and data[1:4] == question[1:4]:
            answers[can_id - SDO_ANSWER_BASE] += 1
            last_s = time.monotonic()

    bus.drain()
    for node_id in answers:
        bus.subscribe(SDO_ANSWER_BASE + node_id, on_answer)
    try:
        for number, node_id in enumerate(answers, start=1):
            bus.send(SDO_REQUEST_BASE + node_id, question)
            if number % _PAUSE_EVERY == 0:
                bus.listen(0.002)
        deadline = time.monotonic() + timeout_s
        never = threading.Event()
        while (now := time.monotonic()) < deadline:
            if all(answers.values()):
                deadline = min(deadline, last_s + _QUIET_S)
            bus.wait(never, min(deadline, now + 0.01))
    finally:
        for node_id in answers:
            bus.unsubscribe(SDO_ANSWER_BASE + node_id, on_answer)
    return answers


def count_answers(bus: Bus, node_ids: Iterable[int], timeout_s: float, *, wakes: bool = True) -> dict[int, int]:
    """Count the devices that respond at each node id within a time [s]; repeated requests wait longer.

    A node that does not answer may be in NMT state STOPPED: it gets a second request and, where this wakes, the command
    to leave it before. Two answers are requested again too, because a frame may have been duplicated on the bus.
    """
    answers = probe(bus, node_ids, timeout_s)
    again = [node_id for node_id, number in answers.items() if number != 1]
    for node_id in again:
        if wakes and answers[node_id] == 0:
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


def require_one(node_id: int, answers: int, state: NmtState | None = None) -> None:
    """Make sure that one device answers at a node id; `state` is the NMT state of its heartbeat, if one was received.

    Raises
    ------
    NodeMissing, DuplicateNode
    """
    if answers == 1:
        return
    if answers > 1:
        advice = "give each drive its own node id"
        raise DuplicateNode(f"{answers} devices answer at this node id", node=node_id, advice=advice)
    if state is None:
        what, advice = "no device answers", "check power, node id, bit rate and cabling"
    elif state is NmtState.STOPPED:
        what = "is in NMT state STOPPED, in which SDO is not available"
        command = f"PRE-OPERATIONAL (CAN id 000, data 80 {node_id:02X})"
        advice = f"find its cause; `servo-gateway restore CELL` sends NMT {command}, or switch the drive off and on"
    else:
        what = f"does not respond to SDO requests, although its heartbeat reports {str(state).upper()}"
        advice = "another tool may use its SDO channel; if not, power-cycle it"
    raise NodeMissing(what, node=node_id, advice=advice)


def read_identity(sdo: SdoClient) -> Identity:
    """Read identity and version objects of a node; an object that it does not have, or refuses, is None."""

    def number(name: str) -> int | None:
        entry = OBJECTS[name]
        try:
            return sdo.read(entry.index, entry.subindex, entry.type)
        except (SdoAbort, SdoProtocolError):
            return None

    def text(name: str) -> str | None:
        try:
            return sdo.read_text(OBJECTS[name].index)
        except SdoAbort:
            return None

    return Identity(
        node_id=sdo.node_id,
        device_type=number("device_type"),
        vendor_id=number("vendor_id"),
        product_code=number("product_code"),
        revision=number("revision"),
        serial_number=number("serial_number"),
        name=text("device_name"),
        hardware_version=text("hardware_version"),
        software_version=text("software_version"),
    )


def is_simulator(sdo: SdoClient) -> bool:
    """Return whether a node reports that it is simulated; a node without the object counts as real.

    Raises
    ------
    SdoTimeout, SdoProtocolError
        The node does not respond.
    """
    entry = OBJECTS["simulator_name"]
    try:
        return sdo.read_text(entry.index, entry.subindex) == SIMULATOR_NAME
    except SdoAbort:
        return False


@dataclass(frozen=True, slots=True)
class ScanResult:
    """Result for one node id that responded.

    Attributes
    ----------
    identity : Identity
    devices : int
        How many answered at this id; more than one is a mistake.
    state : NmtState or None
        From its heartbeat; None = none was received.
    profiles : tuple of str
        Profiles that come with the package and name this vendor and product; generic ones after them.
    unread : str
        Why the identity could not be read; empty where it was read.
    """

    identity: Identity
    devices: int
    state: NmtState | None
    profiles: tuple[str, ...]
    unread: str = ""


def scan(bus: Bus, node_ids: Iterable[int] = range(1, 128), listen_s: float = 0.5) -> tuple[ScanResult, ...]:
    """Find every node without changing anything on it; listen for another master before anything is sent.

    Parameters
    ----------
    bus : Bus
    node_ids : iterable of int
        Ids to ask.
    listen_s : float
        How long to listen for heartbeats and slow answers.

    Raises
    ------
    ForeignMaster
        Another master is active: a request would stop its arm.
    """
    wanted = tuple(node_ids)
    watch = HeartbeatWatch(bus, wanted, [None] * len(wanted))
    try:
        refuse_foreign(bus, max(listen_s, FREE_S))
        found = {node_id: number for node_id, number in probe(bus, wanted, listen_s).items() if number}
        bus.listen(max(0.0, listen_s - _QUIET_S))
        return tuple(_look_at(bus, node_id, number, watch.states[node_id]) for node_id, number in found.items())
    finally:
        watch.close()


def _look_at(bus: Bus, node_id: int, devices: int, state: NmtState | None) -> ScanResult:
    sdo, unread = SdoClient(bus, node_id), ""
    try:
        identity = read_identity(sdo)
    except DriveError as error:
        identity, unread = Identity(node_id), str(error)
    finally:
        sdo.close()
    return ScanResult(identity, devices, state, matching_profiles(identity), unread)


def matching_profiles(identity: Identity) -> tuple[str, ...]:
    """Return the names of the packaged profiles that match a device: those of its vendor first, then the generic one.

    A profile without a vendor id matches no device automatically; an engineer selects it.
    """
    if not identity.is_drive:
        return ()
    fitting = [
        profile
        for name in list_profiles()
        if not identity.mismatches(profile := load_profile(name))
        and (profile.identity.vendor_id is not None or name == GENERIC)
    ]
    fitting.sort(key=lambda profile: (profile.identity.vendor_id is None, profile.name))
    return tuple(profile.name for profile in fitting)
