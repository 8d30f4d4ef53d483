"""NMT commands, heartbeat and node guarding (CiA 301, 7.2.8): the master's, and the monitor of the drives' heartbeats.

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
#: Heartbeats or guarding requests of the master within the time after which a drive treats it as lost.
SIGNS_IN_TIME: Final = 4


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


def rounded_time(value: int, time_ms: int) -> range:
    """Return the values of an object with a time [ms] in its low word that a drive may read back: a tenth off."""
    return range(value - time_ms // 10, min(value + time_ms // 10, value | 0xFFFF) + 1)


def send_nmt(bus: Bus, command: NmtCommand, node_id: int) -> None:
    """Send an NMT command to one node; raises `ForeignMaster` as `Bus.check_free`."""
    bus.check_free()
    bus.send(NMT_ID, bytes([command, node_id]))


class HeartbeatProducer:
    """Sends the master's heartbeat when it is due, by SYNC time or by the wall clock, whichever comes first.

    Beside it a remote frame goes to each drive that watches node guarding instead. While it runs, both are also sent
    whenever the bus waits for an answer.

    Parameters
    ----------
    bus : Bus
    consumer_s : float
        Shortest time after which a drive treats the master as lost [s].
    sync_time_s : callable
        Time that the drives count by SYNCs [s].
    guarded : sequence of int
        Nodes that watch node guarding.
    """

    def __init__(
        self,
        bus: Bus,
        consumer_s: float,
        sync_time_s: Callable[[], float],
        guarded: Sequence[int] = (),
    ) -> None:
        self.running = False
        self._bus = bus
        beat = bus.prepare(HEARTBEAT_BASE + MASTER_NODE_ID, 1)
        beat.data[0] = NmtState.OPERATIONAL
        self._frames = (beat, *(bus.prepare(HEARTBEAT_BASE + node_id, 1, is_remote=True) for node_id in guarded))
        self._interval_s = consumer_s / SIGNS_IN_TIME
        self._due_s = self._sync_time_due_s = 0.0
        self._sync_time_s = sync_time_s

    def start(self) -> None:
        """Send the first heartbeat, from which on the drives monitor it."""
        if not self.running:
            self._bus.add_chore(self.tick)
        self.running = True
        self._beat(time.monotonic(), self._sync_time_s())

    def stop(self) -> None:
        """Stop the heartbeat."""
        self.running = False
        self._bus.remove_chore(self.tick)

    def tick(self) -> None:
        """Send a heartbeat if one is due."""
        now_s, sync_time_s = time.monotonic(), self._sync_time_s()
        if self.running and (sync_time_s >= self._sync_time_due_s or now_s >= self._due_s):
            self._beat(now_s, sync_time_s)

    def _beat(self, now_s: float, sync_time_s: float) -> None:
        for frame in self._frames:
            self._bus.send_frame(frame)
        self._due_s, self._sync_time_due_s = now_s + self._interval_s, sync_time_s + self._interval_s


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
        #: NMT state that the master has commanded last.
        self.commanded = NmtState.OPERATIONAL
        #: By node, heartbeats since then that contradict it: OPERATIONAL was left, or is shown again and again.
        self.contrary: Counter[int] = Counter()
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
        if self.commanded is not NmtState.OPERATIONAL:
            is_contrary = state is NmtState.OPERATIONAL
        else:
            has_left = state in (NmtState.PREOPERATIONAL, NmtState.STOPPED)
            is_contrary = has_left and self.states[node_id] is NmtState.OPERATIONAL
        if is_contrary:
            self.contrary[node_id] += 1
        self.states[node_id] = state
        if state is NmtState.BOOT_UP:
            self.booted.add(node_id)
            self._last_s.pop(node_id, None)
        else:
            self._last_s[node_id] = (time.monotonic(), self._sync_time_s())

    def command(self, state: NmtState) -> None:
        """The nodes are commanded to this NMT state: count heartbeats that contradict it from now on."""
        self.commanded = state
        self.contrary.clear()

    def forgive(self) -> None:
        """Clear boot-ups, of nodes that are about to be started; every timer restarts at the next heartbeat."""
        self.command(NmtState.OPERATIONAL)
        self.booted.clear()
        self._last_s.clear()

    def lost(self) -> tuple[int, ...]:
        """Return the nodes whose heartbeat gap exceeds their limit."""
        now, sync_now = time.monotonic(), self._sync_time_s()
        return tuple(
            node_id
            for node_id, (last_s, sync_last_s) in self._last_s.items()
            if (limit_s := self._limits_s[node_id]) is not None and min(now - last_s, sync_now - sync_last_s) > limit_s
        )
