"""Who is on the bus: every node id is asked once, answers are counted, nothing is written and no state is changed."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

from drives.bus import HEARTBEAT_BASE, SDO_ANSWER_BASE, SDO_REQUEST_BASE, Bus
from drives.errors import BusError, SdoError
from drives.heartbeat import NmtState
from drives.profile import DriveProfile
from drives.sdo import ONCE, SdoClient

FIRST_NODE, LAST_NODE = 1, 127
LISTEN_S = 1.2
# Upload request of 0x1000:00 (CiA 301, 7.2.4.3.5).
PROBE = struct.pack("<BHB4x", 0x40, 0x1000, 0)


@dataclass(frozen=True, slots=True)
class Node:
    """One device that answered or was heard.

    Parameters
    ----------
    node_id : int
    answers : int
        Answers to one request; more than one means that several devices have this id.
    device_type, vendor_id, product_code, revision, serial_number : int or None
        0x1000 and 0x1018; None where the object is missing.
    name, firmware : str
        0x1008 and 0x100A; empty where missing.
    nmt_state : str
        From the heartbeat, empty if none was heard.
    profiles : tuple of str
        Drive profiles whose identity fits, the most specific first.
    """

    node_id: int
    answers: int
    device_type: int | None
    vendor_id: int | None
    product_code: int | None
    revision: int | None
    serial_number: int | None
    name: str
    firmware: str
    nmt_state: str
    profiles: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"profiles": list(self.profiles)}


def scan(bus: Bus, profiles: list[DriveProfile], listen_s: float = LISTEN_S) -> list[Node]:
    """Ask every node id for its device type and read who answers.

    Parameters
    ----------
    bus : Bus
        Open bus.
    profiles : list of DriveProfile
        Profiles to match against.
    listen_s : float
        How long heartbeats and answers are waited for, s.

    Returns
    -------
    list of Node
        By node id.

    Raises
    ------
    BusError
        Nobody answered.
    """
    answers, states = probe(bus, listen_s)
    found = sorted(set(answers) | set(states))
    if not found:
        raise BusError(
            f"{bus.spec}: nobody answered",
            advice="check power, wiring, termination, bit rate and that the interface is the one the drives are on",
        )
    return [_node(bus, node_id, answers[node_id], states.get(node_id, ""), profiles) for node_id in found]


def probe(bus: Bus, listen_s: float) -> tuple[Counter[int], dict[int, str]]:
    """Number of answers to one request, and the NMT state heard, by node id."""
    answers: Counter[int] = Counter()
    states: dict[int, str] = {}

    def on_answer(can_id: int, data: bytes | bytearray, time_s: float) -> None:
        del time_s
        if bytes(data[1:4]) == PROBE[1:4]:
            answers[can_id - SDO_ANSWER_BASE] += 1

    def on_heartbeat(can_id: int, data: bytes | bytearray, time_s: float) -> None:
        del time_s
        if len(data) == 1:
            states[can_id - HEARTBEAT_BASE] = _nmt_state(data[0])

    nodes = range(FIRST_NODE, LAST_NODE + 1)
    for node_id in nodes:
        bus.subscribe(SDO_ANSWER_BASE + node_id, on_answer)
        bus.subscribe(HEARTBEAT_BASE + node_id, on_heartbeat)
    try:
        for node_id in nodes:
            bus.send(SDO_REQUEST_BASE + node_id, PROBE)
            bus.drain()
        bus.listen(listen_s)
    finally:
        for node_id in nodes:
            bus.unsubscribe(SDO_ANSWER_BASE + node_id, on_answer)
            bus.unsubscribe(HEARTBEAT_BASE + node_id, on_heartbeat)
    return answers, states


def fitting_profiles(
    profiles: list[DriveProfile], vendor_id: int | None, product_code: int | None, revision: int | None
) -> tuple[str, ...]:
    """Names of the profiles whose identity holds for this device, those that say most about it first."""
    fitting = []
    for profile in profiles:
        wanted = profile.identity
        exact = [(wanted.vendor_id, vendor_id), (wanted.product_code, product_code)]
        if any(need is not None and need != have for need, have in exact):
            continue
        low, high = wanted.revision_min, wanted.revision_max
        if (low is not None or high is not None) and revision is None:
            continue
        if revision is not None and not (low or 0) <= revision <= (0xFFFFFFFF if high is None else high):
            continue
        said = sum(value is not None for value in (wanted.vendor_id, wanted.product_code, low, high))
        fitting.append((-said, profile.name))
    return tuple(name for _, name in sorted(fitting))


def _node(bus: Bus, node_id: int, answers: int, nmt_state: str, profiles: list[DriveProfile]) -> Node:
    sdo = SdoClient(bus, node_id)
    try:
        numbers = [_number(sdo, *address) for address in ((0x1000, 0), *((0x1018, sub) for sub in range(1, 5)))]
        name, firmware = _text(sdo, 0x1008), _text(sdo, 0x100A)
    finally:
        sdo.close()
    device, vendor, product, revision, serial = numbers
    fitting = fitting_profiles(profiles, vendor, product, revision) if device is not None else ()
    return Node(node_id, answers, device, vendor, product, revision, serial, name, firmware, nmt_state, fitting)


def _number(sdo: SdoClient, index: int, subindex: int) -> int | None:
    try:
        return sdo.read(index, subindex, "u32", ONCE)
    except SdoError:
        return None


def _text(sdo: SdoClient, index: int) -> str:
    try:
        return sdo.read_text(index)
    except SdoError:
        return ""


def _nmt_state(byte: int) -> str:
    try:
        return str(NmtState(byte & 0x7F))
    except ValueError:
        return f"0x{byte:02X}"
