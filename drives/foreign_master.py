"""Refuse a bus on which another master is active: listen before anything is sent; a running arm is not affected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from drives.bus import HEARTBEAT_BASE, NMT_ID, SDO_REQUEST_BASE, SYNC_ID, Bus
from drives.errors import ForeignMaster
from drives.heartbeat import MASTER_NODE_ID

#: A bus on which no master has sent for so long [s] is free: longer than SYNC periods and heartbeats of masters.
FREE_S: Final = 0.5
_MASTER_ONLY: Final = ((SYNC_ID, "SYNC"), (NMT_ID, "NMT commands"))


def refuse_foreign(bus: Bus, listen_s: float = FREE_S, master_node_id: int = MASTER_NODE_ID) -> None:
    """Refuse a bus on which another master is active; nothing is sent. Afterwards `Bus.check_free` monitors the bus.

    Parameters
    ----------
    bus : Bus
    listen_s : float
        How long to listen.
    master_node_id : int
        Node id with which masters send their heartbeat.

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
    bus.subscribe(HEARTBEAT_BASE + master_node_id, on_beat)
    try:
        bus.listen(listen_s)
    finally:
        bus.unsubscribe(HEARTBEAT_BASE + master_node_id, on_beat)
    new = {can_id: number - before.get(can_id, 0) for can_id, number in bus.foreign.items()}
    sent = _sent_by_master(new)
    advice = "end the other master, or wait until it has ended, then start again"
    if beats and not sent:
        advice += f"; if node {master_node_id} is a drive, give it another id: masters have this one"
    sent += [f"the heartbeat of node {master_node_id}"] * bool(beats)
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
