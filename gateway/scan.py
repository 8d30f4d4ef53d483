"""Who is on the bus: every node id is asked once, answers are counted, nothing is written and no state is changed."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from drives.bringup import read_identity
from drives.bus import HEARTBEAT_BASE, SDO_ANSWER_BASE, SDO_REQUEST_BASE, Bus
from drives.errors import BusError, SdoError
from drives.heartbeat import NmtState
from drives.profile import DriveProfile
from drives.sdo import SdoClient
from drives.values import Identity

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
    identity : Identity or None
        None where only a heartbeat was heard, or the device stopped answering.
    nmt_state : str
        From the heartbeat, empty if none was heard.
    profiles : tuple of str
        Drive profiles whose identity fits, the most specific first.
    """

    node_id: int
    answers: int
    identity: Identity | None
    nmt_state: str
    profiles: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"profiles": list(self.profiles)}


def scan(bus: Bus, profiles: Sequence[DriveProfile], listen_s: float = LISTEN_S) -> list[Node]:
    """Ask every node id for its device type and read who answers.

    Parameters
    ----------
    bus : Bus
        Open bus.
    profiles : sequence of DriveProfile
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
    answers, states = probe(bus, range(FIRST_NODE, LAST_NODE + 1), listen_s)
    found = sorted(set(answers) | set(states))
    if not found:
        raise BusError(
            f"{bus.spec}: nobody answered",
            advice="check power, wiring, termination, bit rate and that the interface is the one the drives are on",
        )
    return [_node(bus, node_id, answers[node_id], states.get(node_id, ""), profiles) for node_id in found]


def probe(bus: Bus, nodes: Sequence[int], listen_s: float) -> tuple[Counter[int], dict[int, str]]:
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


def fitting_profiles(identity: Identity, profiles: Sequence[DriveProfile]) -> tuple[str, ...]:
    """Names of the profiles whose identity holds for this device, those that say most about it first."""
    if not identity.is_drive:
        return ()
    fitting = [profile for profile in profiles if not identity.mismatches(profile)]
    return tuple(profile.name for profile in sorted(fitting, key=lambda item: (-_said(item), item.name)))


def _said(profile: DriveProfile) -> int:
    wanted = profile.identity
    parts = (wanted.vendor_id, wanted.product_code, wanted.revision_min, wanted.revision_max)
    return sum(part is not None for part in parts)


def _node(bus: Bus, node_id: int, answers: int, nmt_state: str, profiles: Sequence[DriveProfile]) -> Node:
    identity = _identity(bus, node_id) if answers else None
    return Node(node_id, answers, identity, nmt_state, () if identity is None else fitting_profiles(identity, profiles))


def _identity(bus: Bus, node_id: int) -> Identity | None:
    sdo = SdoClient(bus, node_id)
    try:
        return read_identity(sdo)
    except SdoError:
        return None
    finally:
        sdo.close()


def _nmt_state(byte: int) -> str:
    try:
        return str(NmtState(byte & 0x7F))
    except ValueError:
        return f"0x{byte:02X}"
