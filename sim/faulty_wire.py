"""CAN adapter with fault injection: loses, delays, repeats and generates frames between the drives and their bus.

It replaces the drives' python-can bus: their frames pass `send` and `recv`. Time is counted in SYNC frames; only
delayed answers are delayed in seconds. Faults inside a drive are passed to the drive.
"""

from __future__ import annotations

import errno
import random
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import can

from sim.faults import KINDS, Fault
from sim.wire_rules import HAIR_S, RPDO1, RULES, SYNC, TPDO1, TPDO2, Armed, invented, slow_syncs

#: What an adapter carries out inside a drive.
DriveAction = Callable[[Fault], None]
#: A queue that is full is waited for, as a drive waits for a free mailbox [s].
QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)
QUEUE_PATIENCE_S = 5.0


class FaultyWire:
    """A python-can bus with faults.

    Parameters
    ----------
    bus : can.BusABC
        The real adapter.
    faults : iterable of Fault
        Their `at_sync` counts the SYNCs that this adapter has received.
    act : callable, optional
        Carries out faults of kind `drive` and `object`.
    """

    def __init__(self, bus: Any, faults: Iterable[Fault] = (), act: DriveAction | None = None) -> None:
        self.sync = 0
        #: SYNC period [s], and whether time is real or counted by SYNCs.
        self.period_s, self.real = 0.01, False
        #: Frames by what was done to them.
        self.touched: dict[str, int] = {}
        self.act = act
        #: Called with the number of each SYNC, before the drives receive it.
        self.on_sync: Callable[[int], None] = lambda _sync: None
        #: Called with the number of the SYNC and each frame of a drive, before anything is done to it.
        self.on_frame: Callable[[int, can.Message], None] = lambda _sync, _frame: None
        self._bus = bus
        self._armed: list[Armed] = []
        self._due: list[tuple[float, can.Message]] = []
        self._next_sync: list[can.Message] = []
        self._held: list[tuple[float, can.Message]] = []
        self._answers = [0, 0]
        self._lock = threading.RLock()
        for fault in faults:
            self.arm(fault)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    # -- scenario ----------------------------------------------------------------------------------------------------

    def arm(self, fault: Fault) -> None:
        """Schedule a fault; if its SYNC has passed, it starts now."""
        with self._lock:
            fault = replace(fault, at_sync=max(fault.at_sync, self.sync))
            armed = Armed(fault, fault.count, random.Random(fault.seed))
            self._armed.append(armed)
            if fault.at_sync <= self.sync:
                self._start(armed)

    def arm_in(self, fault: Fault, syncs: int) -> Fault:
        """Schedule a fault a number of SYNCs from now."""
        with self._lock:
            later = replace(fault, at_sync=self.sync + max(syncs, 1))
            self.arm(later)
            return later

    def clear(self) -> None:
        """End every fault on the wire; a drive stays as the fault left it."""
        with self._lock:
            self._armed.clear()
            self._due.clear()
            self._next_sync.clear()
            self._held.clear()

    def _start(self, armed: Armed) -> None:
        if armed.started or not armed.fault.active(self.sync):
            return
        armed.started = True
        for delay_s, frame in slow_syncs(armed.fault):
            self.later(frame, delay_s)
            self._count(armed)
        if self.act is not None and (KINDS[armed.fault.kind].where in ("drive", "object")):
            self._count(armed)
            self.act(armed.fault)

    def _active(self, node: int) -> list[Armed]:
        return [each for each in self._armed if each.fault.active(self.sync) and each.fault.concerns(node)]

    def _count(self, armed: Armed) -> None:
        self.touched[armed.fault.kind] = self.touched.get(armed.fault.kind, 0) + 1

    # -- python-can --------------------------------------------------------------------------------------------------

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, subject to the faults."""
        with self._lock:
            self.on_frame(self.sync, msg)
            for frame in self._through(msg):
                self._put(frame)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame for the drives; delayed frames are sent when they are due."""
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            self._flush()
            wait = None if end is None else max(end - time.monotonic(), 0.0)
            first = next(iter(self._due), None)
            if first is not None:
                wait = min(first[0] - time.monotonic(), 0.05 if wait is None else wait)
            frame = self._bus.recv(None if wait is None else max(wait, 0.0))
            if frame is not None and self._reaches_drives(frame):
                return frame
            if frame is None and end is not None and time.monotonic() >= end:
                return None

    def shutdown(self) -> None:
        """Close the adapter."""
        self.clear()
        self._bus.shutdown()

    def __enter__(self) -> FaultyWire:
        return self

    def __exit__(self, *exception: object) -> None:
        self.shutdown()

    def _put(self, frame: can.Message) -> None:
        end = time.monotonic() + QUEUE_PATIENCE_S
        while True:
            try:
                return self._bus.send(frame)
            except can.CanOperationError as error:
                full = error.error_code in QUEUE_FULL or "buffer full" in str(error)
                if not full or time.monotonic() > end:
                    raise
            time.sleep(0.001)

    def _flush(self) -> None:
        with self._lock:
            while self._due and self._due[0][0] <= time.monotonic():
                self._put(self._due.pop(0)[1])

    def later(self, frame: can.Message, delay_s: float) -> None:
        """Send the frame after a delay in real time."""
        self._at(frame, time.monotonic() + delay_s)

    def _at(self, frame: can.Message, due_s: float) -> None:
        self._due.append((due_s, frame))
        self._due.sort(key=lambda entry: entry[0])

    @property
    def now_s(self) -> float:
        """Return the time of the drives: real, or by SYNCs."""
        return time.monotonic() if self.real else self.sync * self.period_s

    def hold(self, frame: can.Message, due_s: float) -> None:
        """Send the frame at a time of the drives, after those that are due by then."""
        if self.real:
            self._at(frame, due_s)
        else:
            self._held.append((due_s, frame))

    def after_next_sync(self, frame: can.Message) -> None:
        """Send the frame when the next SYNC has come."""
        self._next_sync.append(frame)

    @property
    def answers_per_sync(self) -> int:
        """Return the number of TPDOs that followed the last SYNC."""
        return self._answers[1]

    # -- towards the drives ------------------------------------------------------------------------------------------

    def _reaches_drives(self, frame: can.Message) -> bool:
        if frame.is_error_frame or frame.is_extended_id:
            return True
        can_id = frame.arbitration_id
        if can_id == SYNC:
            return self._on_sync()
        node = can_id & 0x7F
        with self._lock:
            for armed in self._active(node):
                kind = armed.fault.kind
                deaf = kind in ("node_killed", "node_missing") and armed.fault.node == node and can_id > 0x180
                if deaf or kind in ("rpdo_lost", "rpdo_gone") and can_id == RPDO1 + node and armed.take():
                    self._count(armed)
                    return False
        return True

    def _on_sync(self) -> bool:
        with self._lock:
            self.sync += 1
            self.on_sync(self.sync)
            self._answers = [0, self._answers[0]]
            late, self._next_sync = self._next_sync, []
            late += [frame for due_s, frame in self._held if due_s <= self.now_s + HAIR_S]
            self._held = [(due_s, frame) for due_s, frame in self._held if due_s > self.now_s + HAIR_S]
            for frame in late:
                self._put(frame)
            reaches = True
            for armed in list(self._armed):
                if not armed.fault.active(self.sync):
                    continue
                self._start(armed)
                if armed.fault.kind == "sync_lost":
                    self._count(armed)
                    reaches = False
                for frame in invented(armed.fault):
                    if armed.take():
                        self._count(armed)
                        self._put(frame)
            return reaches

    # -- from the drives ---------------------------------------------------------------------------------------------

    def _through(self, msg: can.Message) -> list[can.Message]:
        can_id = msg.arbitration_id
        node, group = can_id & 0x7F, can_id & 0x780
        if group in (TPDO1, TPDO2):
            self._answers[0] += 1
        frames = [msg]
        for armed in self._active(node):
            rule = RULES.get(armed.fault.kind)
            if rule is None or group not in rule[0]:
                continue
            touched = []
            for frame in frames:
                changed = rule[1](self, armed, frame)
                touched += [frame] if changed is None else changed
                if changed is not None:
                    self._count(armed)
            frames = touched
        return frames
