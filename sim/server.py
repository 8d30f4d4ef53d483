"""Simulated drives on one bus: frames in, physics forward, frames out; one thread, no asyncio.

If one plant is on several buses that can be waited for together, one thread serves them in real time, frame after frame
in the order of arrival.

Lockstep: simulated time advances by one SYNC period with each SYNC. Real: it follows the wall clock, and a frame acts
at the time it was received, even if it is processed later. At a SYNC the synchronous RPDOs become valid and the TPDOs
show the state of that instant; only then does the physics move on, while the master already works on the answers.
"""

from __future__ import annotations

import gc
import select
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import can
import canopen
import numpy as np

from sim.cellfile import ArmSpec, AxisSpec
from sim.fake_drive import FakeDrive
from sim.faults import act
from sim.makes import QUIRKS
from sim.measuring import FakeMeasuringDevice
from sim.node import SlaveNode
from sim.physics import ArmWorld
from sim.plant import Payload, Plant
from sim.servo import TICK_S

SYNC_ID = 0x080
HEARTBEAT_ID = 0x700
IDLE_S = 0.05
REAL_STEP_S = 0.001
#: Real pacing: what the physics may have to catch up at once after a stall of the machine [s].
MOST_CATCH_UP_S = 0.5
#: A frame with an older time stamp has a different clock [s].
OLDEST_FRAME_S = 5.0
#: In lockstep a master that has sent no frame for this time counts as lost, and real time applies [s].
ABANDONED_S = 10.0
#: Longest wait for the serving thread to mount a load [s].
MOUNT_S = 10.0


class Unit(ABC):
    """One arm on its bus: drives, and the physics that moves their motors.

    Parameters
    ----------
    name : of the arm
    world : physics
    drives : node id, axis and motor of each drive
    sync_period_s : of the bus
    limited : the drives have software position limits

    Attributes
    ----------
    name, world : as given
    drives : in the order of the cell's axes
    instruments : measuring devices on the same bus
    send : sends a frame on the bus
    """

    def __init__(
        self,
        name: str,
        world: Any,
        drives: Iterable[tuple[int, AxisSpec, Any]],
        sync_period_s: float,
        limited: bool = True,
    ) -> None:
        self.name, self.world = name, world
        self.send: Callable[[can.Message], None] = lambda _message: None
        self.instruments: list[FakeMeasuringDevice] = []
        self.drives = [FakeDrive(*drive, sync_period_s, self.put, limited) for drive in drives]
        for drive in self.drives:
            for quirk in QUIRKS.get(str(drive.spec.profile.get("name")), ()):
                act([drive], quirk)
            drive.keep_as_built()
        self.measure()

    def put(self, message: can.Message) -> None:
        """Send a frame of a device."""
        self.send(message)

    @abstractmethod
    def readings_nm(self) -> list[float]:
        """Return the motor torque that each drive measures, gear output side [Nm]."""

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Advance simulated time."""

    def measure(self) -> None:
        """Hand one reading to each drive."""
        for drive, reading in zip(self.drives, self.readings_nm(), strict=True):
            drive.reading_nm = reading

    def sync(self) -> None:
        """Process a SYNC: apply the setpoints, then send the synchronous TPDOs."""
        self.measure()
        for device in (*self.drives, *self.instruments):
            device.sync()

    def plan(self, ticks: float) -> None:
        """Let the drives set their references for the milliseconds to come."""
        for drive in self.drives:
            drive.motion.plan(ticks)

    def advanced(self, time_s: float) -> None:
        """Let the drives monitor what happened until `time_s`."""
        for drive in self.drives:
            drive.advanced(time_s)


class ArmUnit(Unit):
    """One arm alone, as its plant describes it."""

    def __init__(self, arm: ArmSpec, plant: Plant, sync_period_s: float, seed: int) -> None:
        world = ArmWorld(arm, plant, seed, [float(axis.profile["torque"].get("filter_s", 0.0)) for axis in arm.axes])
        self._joints = [int(joint) for joint in plant.drive_joint]
        self._rest_s = 0.0
        coupled = not np.array_equal(arm.coupling, np.eye(len(arm.axes)))
        drives = [
            (axis.node_id, arm.axes[joint], world.axes[joint])
            for axis, joint in zip(arm.axes, self._joints, strict=True)
        ]
        super().__init__(arm.name, world, drives, sync_period_s, not coupled)

    def readings_nm(self) -> list[float]:
        """Return what each drive measures of the joint that it is bolted to."""
        reading = self.world.reading_nm().tolist()
        return [reading[joint] for joint in self._joints]

    def advance(self, seconds: float) -> None:
        """Advance simulated time; a fraction of a millisecond is carried over to the next call."""
        self._rest_s += seconds
        ticks = int(self._rest_s / TICK_S + 1e-6)
        if ticks <= 0:
            return
        self._rest_s -= ticks * TICK_S
        self.plan(ticks)
        self.world.advance(ticks)
        self.advanced(self.world.time_s)


class BusServer:
    """All drives of one bus.

    Parameters
    ----------
    bus : python-can bus, owned and shut down by the server
    arms : the arms whose drives are on it
    sync_period_s, pacing : as in the cell file

    Attributes
    ----------
    latest_s : in real time, longest delay of this process [s]
    real : simulated time follows the wall clock
    real_at_s : instant of the monotonic clock that real time has reached [s]
    """

    def __init__(self, bus: Any, arms: Sequence[Unit], sync_period_s: float, pacing: str) -> None:
        self.bus, self.arms = bus, tuple(arms)
        self._born_s = tuple(arm.drives[0].motion.period_s() for arm in self.arms)
        self.sync_count, self.latest_s = 0, 0.0
        self._period_s, self.real = sync_period_s, pacing == "real"
        self._network = canopen.Network(bus)
        self._jobs: deque[Callable[[], None]] = deque()
        self._stop = threading.Event()
        self._routes: dict[int, tuple[FakeDrive, int]] = {}
        self.real_at_s = time.monotonic()
        self._beat_at_s = 0.0
        self._received_at_s = self._alone_at_s = time.monotonic()
        self.drives = [drive for arm in self.arms for drive in arm.drives]
        self.instruments = [device for arm in self.arms for device in arm.instruments]
        for arm in self.arms:
            arm.send = bus.send
        for drive in self.drives:
            drive.motion.buffered = self.real
            for pdo in drive.rpdos:
                pdo.on_change = self._reroute
        for node in self.nodes:
            node.associate_network(self._network)
        self._reroute()

    @property
    def nodes(self) -> list[SlaveNode]:
        """Return all devices of the bus."""
        return [device.node for device in (*self.drives, *self.instruments)]

    def drive(self, node_id: int) -> FakeDrive:
        """Return the drive with a node id."""
        return next(drive for drive in self.drives if drive.node_id == node_id)

    def _reroute(self) -> None:
        self._routes = {
            pdo.frame_id: (drive, number)
            for drive in self.drives
            for number, pdo in enumerate(drive.rpdos)
            if pdo.enabled
        }

    # ----------------------------------------------------------------------------------------------------- the loop

    def later(self, job: Callable[[], None]) -> None:
        """Schedule a call in the serving thread between two frames."""
        self._jobs.append(job)

    def mount(self, arm: Unit, payload: Payload) -> None:
        """Mount a load on an arm's flange; return when it is mounted (call from another thread than the server's).

        Raises
        ------
        TimeoutError : the server does not run, or is suspended
        """
        done = threading.Event()

        def job() -> None:
            arm.world.mount(payload)
            done.set()

        self.later(job)
        if not done.wait(MOUNT_S):
            raise TimeoutError(f"arm {arm.name}: the load was not mounted within {MOUNT_S:g} s; does its bus run?")

    def stop(self) -> None:
        """Request the end of `run`."""
        self._stop.set()

    def run(self) -> None:
        """Serve until `stop`; closes the bus."""
        try:
            self.boot()
            wait, recv = self.step_s, self.bus.recv
            while not self._stop.is_set():
                gap_s = time.monotonic() + wait
                message = recv(wait)
                if self.real:
                    self._follow_the_clock(message, gap_s)
                self.serve(message)
        finally:
            self.end()

    @property
    def step_s(self) -> float:
        """Return the longest wait for frames before periodic work [s]."""
        return REAL_STEP_S if self.real else IDLE_S

    @property
    def stopped(self) -> bool:
        """Return whether `stop` was called."""
        return self._stop.is_set()

    def boot(self) -> None:
        """Send the boot-up messages of all nodes and start the time."""
        self.real_at_s = time.monotonic()
        for node in self.nodes:
            node.boot()
        if self.real:  # a full garbage collection takes longer than a SYNC period
            gc.collect()
            gc.freeze()

    def end(self) -> None:
        """End the service and close the bus."""
        if self.real:
            gc.unfreeze()
        for node in self.nodes:
            node.remove_network()
        self.bus.shutdown()

    def serve(self, message: can.Message | None) -> None:
        """Process a frame, or None if no frame arrived."""
        if message is not None and not message.is_error_frame and not message.is_extended_id:
            self._take(message)
        while self._jobs:
            self._jobs.popleft()()
        now = time.monotonic()
        if message is not None:
            self._received_at_s = now
        elif not self.real and now - self._received_at_s > ABANDONED_S:
            self._go_on_alone(now)
        if message is None or message.arbitration_id == SYNC_ID or now - self._beat_at_s > IDLE_S:
            self._beat_at_s = now
            self._keep_time(now)

    def _go_on_alone(self, now_s: float) -> None:
        """In lockstep, when the master is lost: advance in real time while a drive powers its motor."""
        passed = min(now_s - max(self._alone_at_s, self._received_at_s + ABANDONED_S), MOST_CATCH_UP_S)
        self._alone_at_s = now_s
        for arm in self.arms:
            if any(drive.automaton.energised for drive in arm.drives):
                arm.advance(passed)

    def _take(self, message: can.Message) -> None:
        identifier = message.arbitration_id
        route = self._routes.get(identifier)
        if route is not None:
            route[0].rpdo_received(route[1], bytes(message.data))
        elif identifier == SYNC_ID:
            self._sync()
        elif identifier > HEARTBEAT_ID:
            for drive in self.drives:
                of_this = drive.node_id == identifier - HEARTBEAT_ID
                if of_this and message.is_remote_frame:
                    drive.node.answer_guarding(drive.time_s)
                elif not of_this and not message.is_remote_frame:
                    drive.node.note_heartbeat(identifier - HEARTBEAT_ID, drive.time_s)
        elif identifier not in range(0x081, 0x580) and not message.is_remote_frame:
            self._network.notify(identifier, message.data, message.timestamp)

    def _sync(self) -> None:
        self.sync_count += 1
        for arm in self.arms:
            arm.sync()
        if not self.real:
            for arm, born_s in zip(self.arms, self._born_s, strict=True):
                period_s = arm.drives[0].motion.period_s()
                # a SYNC advances by the period of the cell, until the master has set another one (0x60C2)
                arm.advance(self._period_s if period_s == born_s else period_s)

    def _follow_the_clock(self, message: can.Message | None, gap_s: float) -> None:
        """Advance the time until a frame was received, or until now.

        Not beyond: a frame may have arrived since, and its command belongs to its time of arrival.
        """
        self.pass_until(gap_s if message is None else came_s(message))

    def pass_until(self, now_s: float) -> None:
        """Advance simulated time to an instant of the monotonic clock."""
        self.latest_s = max(self.latest_s, time.monotonic() - now_s)
        passed = min(now_s - self.real_at_s, MOST_CATCH_UP_S)
        if passed <= 0.0:
            return
        self.real_at_s = now_s
        for arm in self.arms:
            arm.advance(passed)

    def _keep_time(self, wall_s: float) -> None:
        for arm in self.arms:
            now = arm.world.time_s
            for drive in arm.drives:
                drive.send_events(now)
                drive.node.keep_time(now, wall_s)
            for device in arm.instruments:
                device.node.keep_time(now, wall_s)


def can_be_waited_for(bus: Any) -> bool:
    """Return whether a bus supports `select` together with others."""
    try:
        return bus.fileno() >= 0
    except (AttributeError, NotImplementedError):
        return False


def serve_together(servers: Sequence[BusServer]) -> None:
    """Serve several buses of one plant in real time in this thread, until one of them is stopped; close all of them.

    Frames of all buses are acted on in the order in which they were received: where one bus has no frame, none has come
    on it before the one that is acted on.
    """
    heads: list[can.Message | None] = [None] * len(servers)
    sockets, wait = [server.bus.fileno() for server in servers], min(server.step_s for server in servers)
    try:
        for server in servers:
            server.boot()
        while not any(server.stopped for server in servers):
            gap_s = time.monotonic() + wait
            heads = [
                server.bus.recv(0.0) if head is None else head for server, head in zip(servers, heads, strict=True)
            ]
            came = [(came_s(head), index) for index, head in enumerate(heads) if head is not None]
            if not came:
                if select.select(sockets, [], [], wait)[0]:
                    continue
                for server in servers:
                    server.pass_until(gap_s)
                for server in servers:
                    server.serve(None)
                continue
            at_s, index = min(came)
            for server in servers:
                server.pass_until(at_s)
            message, heads[index] = heads[index], None
            servers[index].serve(message)
    finally:
        for server in servers:
            server.end()


def came_s(message: can.Message) -> float:
    """Return the monotonic time at which a frame was received [s]."""
    now, age = time.monotonic(), time.time() - message.timestamp
    return now - age if 0.0 < age < OLDEST_FRAME_S else now
