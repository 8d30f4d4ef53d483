"""NMT commands and heartbeat (CiA 301, 7.2.8): producer of the master's heartbeat, monitor of the drives' heartbeats.

A drive is monitored from its first heartbeat on.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Final

from drives.bus import HEARTBEAT_BASE, NMT_ID, Bus

#: Node id with which a master sends its heartbeat.
MASTER_NODE_ID: Final = 127


class NmtCommand(IntEnum):
    """NMT command specifiers."""

    START = 0x01
    STOP = 0x02
    ENTER_PREOPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """NMT states as coded in the heartbeat."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PREOPERATIONAL = 0x7F

    def __str__(self) -> str:
        return self.name.replace("_", "-").lower()


_STATES: Final = {int(state): state for state in NmtState}


def send_nmt(bus: Bus, command: NmtCommand, node_id: int) -> None:
    """Send an NMT command to one node; raises `ForeignMaster` as `Bus.check_free`."""
    bus.check_free()
    bus.send(NMT_ID, bytes([command, node_id]))


class HeartbeatProducer:
    """Sends the master's heartbeat when it is due, by SYNC time or by the wall clock, whichever comes first.

    While it runs, it is also sent whenever the bus waits for an answer.

    Parameters
    ----------
    bus : Bus
    master_node_id : int
        Node id of the master.
    consumer_s : float
        Shortest heartbeat consumer time of the drives [s]; four heartbeats are sent in that time.
    """

    def __init__(self, bus: Bus, master_node_id: int, consumer_s: float) -> None:
        self.running = False
        self._bus = bus
        self._frame = bus.prepare(HEARTBEAT_BASE + master_node_id, 1)
        self._frame.data[0] = NmtState.OPERATIONAL
        self._interval_s = consumer_s / 4.0
        self._due_s = 0.0
        self._sync_time_s = self._sync_time_due_s = 0.0

    def start(self, sync_time_s: float) -> None:
        """Send the first heartbeat, from which on the drives monitor it."""
        if not self.running:
            self._bus.add_chore(self._chore)
        self.running = True
        self._beat(time.monotonic(), sync_time_s)

    def stop(self) -> None:
        """Stop the heartbeat."""
        self.running = False
        self._bus.remove_chore(self._chore)

    def tick(self, sync_time_s: float) -> None:
        """Send a heartbeat if one is due; `sync_time_s` is the time that the drives count by SYNCs."""
        now = time.monotonic()
        self._sync_time_s = sync_time_s
        if self.running and (sync_time_s >= self._sync_time_due_s or now >= self._due_s):
            self._beat(now, sync_time_s)

    def _chore(self) -> None:
        self.tick(self._sync_time_s)

    def _beat(self, now_s: float, sync_time_s: float) -> None:
        self._bus.send_frame(self._frame)
        self._due_s = now_s + self._interval_s
        self._sync_time_s, self._sync_time_due_s = sync_time_s, sync_time_s + self._interval_s


class HeartbeatWatch:
    """NMT state and time of the last heartbeat of each drive.

    Parameters
    ----------
    bus : Bus
    node_ids : sequence of int
        Nodes to monitor.
    limits_s : sequence of float or None
        Longest gap of each, None = its heartbeat is not expected.
    sync_time_s : callable, optional
        Time by SYNCs. In lockstep a drive may count by SYNCs or by its own clock: it is lost only when the gap is too
        long by both.
    """

    def __init__(
        self,
        bus: Bus,
        node_ids: Sequence[int],
        limits_s: Sequence[float | None],
        sync_time_s: Callable[[], float] | None = None,
    ) -> None:
        self.states: dict[int, NmtState | None] = dict.fromkeys(node_ids)
        #: Nodes that booted since `forgive` was called.
        self.booted: set[int] = set()
        #: Nodes whose heartbeat showed that they left OPERATIONAL since then.
        self.left: set[int] = set()
        #: Heartbeats in OPERATIONAL since the nodes were commanded to leave it; None = they may be in it.
        self.started: Counter[int] | None = None
        self._limits_s = dict(zip(node_ids, limits_s, strict=True))
        self._last_s: dict[int, tuple[float, float]] = {}
        self._sync_time_s = sync_time_s or time.monotonic
        self._bus = bus
        for node_id in node_ids:
            bus.subscribe(HEARTBEAT_BASE + node_id, self._on_frame)

    def close(self) -> None:
        """Stop listening."""
        for node_id in self.states:
            self._bus.unsubscribe(HEARTBEAT_BASE + node_id, self._on_frame)

    def _on_frame(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        if len(data) != 1:
            self._bus.counts["wrong_length"] += 1
            return
        node_id = can_id - HEARTBEAT_BASE
        state = _STATES.get(data[0] & 0x7F)
        if self.states[node_id] is NmtState.OPERATIONAL and state in (NmtState.PREOPERATIONAL, NmtState.STOPPED):
            self.left.add(node_id)
        self.states[node_id] = state
        if self.started is not None and state is NmtState.OPERATIONAL:
            self.started[node_id] += 1
        if state is NmtState.BOOT_UP:
            self.booted.add(node_id)
            self._last_s.pop(node_id, None)
        else:
            self._last_s[node_id] = (time.monotonic(), self._sync_time_s())

    def left_operational(self) -> None:
        """The nodes are commanded to leave OPERATIONAL: from now on their heartbeats in it are counted."""
        self.started = Counter()

    def forgive(self) -> None:
        """Clear boot-ups and state changes; every timer restarts at the next heartbeat."""
        self.started = None
        self.booted.clear()
        self.left.clear()
        self._last_s.clear()

    def lost(self) -> tuple[int, ...]:
        """Return the nodes whose heartbeat gap exceeds their limit."""
        now, sync_now = time.monotonic(), self._sync_time_s()
        return tuple(
            node_id
            for node_id, (last_s, sync_last_s) in self._last_s.items()
            if (limit_s := self._limits_s[node_id]) is not None and min(now - last_s, sync_now - sync_last_s) > limit_s
        )
