"""Decode the CANopen frames of a black box into event text: drive states, emergencies, SDO, NMT; t = 0 is the stop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drives.abort import ABORT_CODES
from drives.bus import EMCY_BASE, HEARTBEAT_BASE, NMT_ID, SDO_ANSWER_BASE, SDO_REQUEST_BASE, SYNC_ID
from drives.cia402 import State, decode_state
from drives.emcy import parse_emergency
from drives.frame_log import ERROR, EXTENDED, RECEIVED, REMOTE
from drives.heartbeat import NmtCommand, NmtState
from drives.objects import OBJECTS
from drives.profile import DriveProfile
from drives.profile_file import list_profiles, load_profile
from drives.sdo import ABORT, CCS_DOWNLOAD, COMMAND_BITS, EXPEDITED, SCS_UPLOAD, expedited_data
from gateway.cell.config import parse_cell
from gateway.data.blackbox.box import BlackBox
from gateway.errors import ConfigError

#: TPDO1 begins with the statusword, RPDO1 with the controlword: `drives.pdo`.
TPDO1_BASE: Final = 0x180
RPDO1_BASE: Final = 0x200
#: A drive counts as not responding after this many times the median interval of its answers.
RESPONSE_PERIODS: Final = 5.0
#: Equal messages of several nodes within this time are merged [s].
TOGETHER_S: Final = 0.005
_NODES: Final = 128
_OBJECTS: Final = {entry.address: str(entry) for entry in OBJECTS.values()}


@dataclass(frozen=True, slots=True)
class DecodedEvent:
    """Decoded message that one or several nodes sent or received.

    Attributes
    ----------
    time_s : float
        Time relative to the stop; negative before it.
    nodes : tuple of int
        0: every node.
    what : str
    """

    time_s: float
    nodes: tuple[int, ...]
    what: str


@dataclass(frozen=True, slots=True)
class StateSpan:
    """Time in which a drive reported one state: first and last answer with it [s relative to the stop]."""

    begin_s: float
    end_s: float
    state: State


@dataclass(frozen=True, slots=True)
class BoxDrive:
    """Drive that sent frames of the box: arm, joint (from 1), and its profile if the package contains it."""

    arm: str
    joint: int
    profile: DriveProfile | None


def drives_of(box: BlackBox) -> dict[int, BoxDrive]:
    """Return the drives of the arms by node id; empty if this version of the program cannot read the cell file of the
    box.
    """
    try:
        cell = parse_cell(box.cell, f"{box.path}: cell")
    except ConfigError:
        return {}
    held, known = {arm.name for arm in box.arms}, list_profiles()
    return {
        axis.node_id: BoxDrive(arm.name, joint, load_profile(axis.profile) if axis.profile in known else None)
        for arm in cell.arm
        if arm.name in held
        for joint, axis in enumerate(arm.axis, start=1)
    }


def sample_times_s(box: BlackBox) -> NDArray[np.float64]:
    """Return the times (n,) of the samples [s]; the last sample is the stop, t = 0."""
    return box.time_s - box.time_s[-1] if len(box.time_s) else box.time_s


def frame_times_s(box: BlackBox) -> NDArray[np.float64]:
    """Return the times (m,) of the frames [s]: run time where samples exist, otherwise from the wall clock."""
    wall_s = np.asarray(box.frames["time_s"], dtype=float)
    if not len(box.time_s):
        return wall_s - wall_s[-1:]
    known_s, run_s = np.maximum.accumulate(box.wall_s), sample_times_s(box)
    inside = np.interp(wall_s, known_s, run_s)
    outside = np.where(wall_s > known_s[-1], wall_s - known_s[-1], np.minimum(wall_s - known_s[0], 0.0))
    return inside + outside


def state_spans(box: BlackBox, node: int) -> list[StateSpan]:
    """Return the states of one drive in time order, with gaps while it did not respond."""
    chosen = box.frames["can_id"] == TPDO1_BASE + node
    time_s, words = frame_times_s(box)[chosen], _first_words(box.frames[chosen])
    states = [decode_state(word) for word in words.tolist()]
    limit_s = _response_limit_s(time_s)
    found: list[StateSpan] = []
    for at_s, state in zip(time_s.tolist(), states, strict=True):
        last = found[-1] if found else None
        if last is not None and at_s - last.end_s <= limit_s and last.state is state:
            found[-1] = StateSpan(last.begin_s, at_s, state)
        elif last is not None and at_s - last.end_s <= limit_s:
            found[-1] = StateSpan(last.begin_s, at_s, last.state)
            found.append(StateSpan(at_s, at_s, state))
        else:
            found.append(StateSpan(at_s, at_s, state))
    return found


def decoded_events(box: BlackBox) -> list[DecodedEvent]:
    """Return all decoded messages in time order, except those that repeat unchanged at every SYNC."""
    drives, time_s = drives_of(box), frame_times_s(box)
    events = [*_service(box, time_s, drives), *_heartbeats(box, time_s)]
    for node in drives:
        events += _states(box, node)
        events += _commands(box, time_s, node)
    return _together(sorted(events, key=lambda each: (each.time_s, each.nodes)))


def _first_words(frames: NDArray[Any]) -> NDArray[np.int64]:
    return frames["data"][:, 0].astype(np.int64) | frames["data"][:, 1].astype(np.int64) << 8


def _response_limit_s(time_s: NDArray[np.float64]) -> float:
    return RESPONSE_PERIODS * float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf


def _states(box: BlackBox, node: int) -> Iterator[DecodedEvent]:
    """Return every change of the state of a drive, and the times without response."""
    found = state_spans(box, node)
    for before, after in zip(found, found[1:], strict=False):
        if before.end_s == after.begin_s:
            yield DecodedEvent(after.begin_s, (node,), f"{before.state} > {after.state}")
        else:
            gap_s = after.begin_s - before.end_s
            yield DecodedEvent(before.end_s, (node,), f"no response for {gap_s:.3f} s, then {after.state}")
    syncs_s = frame_times_s(box)[box.frames["can_id"] == SYNC_ID]
    if found and len(syncs_s) and syncs_s[-1] - found[-1].end_s > _response_limit_s(syncs_s):
        yield DecodedEvent(found[-1].end_s, (node,), "last answer to a SYNC")


def _commands(box: BlackBox, time_s: NDArray[np.float64], node: int) -> Iterator[DecodedEvent]:
    """Return every change of the controlword sent to a drive."""
    chosen = box.frames["can_id"] == RPDO1_BASE + node
    words = _first_words(box.frames[chosen])
    for place in np.flatnonzero(np.diff(words)).tolist():
        at_s = float(time_s[chosen][place + 1])
        yield DecodedEvent(at_s, (node,), f"is sent controlword 0x{words[place + 1]:04X} after 0x{words[place]:04X}")


def _heartbeats(box: BlackBox, time_s: NDArray[np.float64]) -> Iterator[DecodedEvent]:
    """Return every change of the NMT state in a node's heartbeat, and the time when its heartbeat stopped."""
    last: dict[int, int] = {}
    beats: dict[int, list[float]] = {}
    for place in _of(box, HEARTBEAT_BASE):
        node = int(box.frames["can_id"][place]) - HEARTBEAT_BASE
        state = int(box.frames["data"][place, 0]) & 0x7F
        if last.get(node, state if state else None) != state:
            said = str(NmtState(state)) if state in set(NmtState) else f"0x{state:02X}"
            yield DecodedEvent(float(time_s[place]), (node,), f"NMT {said}")
        last[node] = state
        beats.setdefault(node, []).append(float(time_s[place]))
    latest_s = max((at_s[-1] for at_s in beats.values()), default=0.0)
    for node, at_s in beats.items():
        if latest_s - at_s[-1] > _response_limit_s(np.array(at_s)):
            yield DecodedEvent(at_s[-1], (node,), "last heartbeat")


def _of(box: BlackBox, base: int) -> list[int]:
    """Return the indices of the frames whose identifier is `base` plus a node id (1 to 127)."""
    ids, odd = box.frames["can_id"], box.frames["flags"] & (EXTENDED | REMOTE | ERROR)
    return np.flatnonzero((ids > base) & (ids < base + _NODES) & (odd == 0)).tolist()


def _service(box: BlackBox, time_s: NDArray[np.float64], drives: dict[int, BoxDrive]) -> Iterator[DecodedEvent]:
    """Return emergency messages, SDO transfers, NMT commands and error frames."""
    frames = box.frames
    for place in np.flatnonzero(frames["flags"] & ERROR).tolist():
        yield DecodedEvent(float(time_s[place]), (0,), "error frame of the adapter")
    for place in _of(box, EMCY_BASE):
        node = int(frames["can_id"][place]) - EMCY_BASE
        profile = drives[node].profile if node in drives else None
        yield DecodedEvent(
            float(time_s[place]), (node,), f"EMCY {parse_emergency(node, _content(frames[place]), 0, profile).what}"
        )
    for base in (SDO_REQUEST_BASE, SDO_ANSWER_BASE):
        for place in _of(box, base):
            said = _sdo(_content(frames[place]), base == SDO_REQUEST_BASE)
            if said:
                yield DecodedEvent(float(time_s[place]), (int(frames["can_id"][place]) - base,), said)
    for place in np.flatnonzero((frames["can_id"] == NMT_ID) & (frames["length"] >= 2)).tolist():
        command, node = (int(byte) for byte in frames["data"][place, :2])
        if command in set(NmtCommand):
            name = NmtCommand(command).name.lower().replace("_", " ")
            who = "" if not frames["flags"][place] & RECEIVED else " by another master"
            yield DecodedEvent(float(time_s[place]), (node,), f"is sent NMT {name}{who}")


def _content(frame: Any) -> bytes:
    return bytes(frame["data"])[: frame["length"]]


def _sdo(data: bytes, request: bool) -> str:
    """Return the text of an SDO frame; empty if the matching request or answer already contains it."""
    if len(data) < 8:
        return ""
    address = int.from_bytes(data[1:3], "little"), data[3]
    name = _OBJECTS.get(address, f"{address[0]:04X}:{address[1]:02X}")
    if data[0] == ABORT:
        code = int.from_bytes(data[4:8], "little")
        what, _ = ABORT_CODES.get(code, ("code unknown to CiA 301", ""))
        return f"SDO {name}: {'master ' if request else ''}abort 0x{code:08X}, {what}"
    if data[0] & COMMAND_BITS != (CCS_DOWNLOAD if request else SCS_UPLOAD):
        return ""
    verb = "is written" if request else "reads"
    if not data[0] & EXPEDITED:
        return f"SDO {name} {verb} in segments"
    value = expedited_data(data)
    return f"SDO {name} {verb} 0x{int.from_bytes(value, 'little'):0{2 * len(value)}X}"


def _together(events: list[DecodedEvent]) -> list[DecodedEvent]:
    """Merge equal messages of several nodes at about the same time into one."""
    found: list[DecodedEvent] = []
    last: dict[str, int] = {}
    for each in events:
        place = last.get(each.what)
        if place is not None and each.time_s - found[place].time_s <= TOGETHER_S:
            same = found[place]
            found[place] = DecodedEvent(same.time_s, tuple(dict.fromkeys((*same.nodes, *each.nodes))), same.what)
        else:
            last[each.what] = len(found)
            found.append(each)
    return found
