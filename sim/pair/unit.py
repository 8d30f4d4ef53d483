"""One arm of a pair on its bus: drives whose motors are in the common world."""

from __future__ import annotations

from collections.abc import Callable

import can

from sim.cellfile import ArmSpec, CellBus
from sim.fake_drive import FakeDrive
from sim.measuring import FakeMeasuringDevice
from sim.pair.two_arms import TwoArms
from sim.plant import Payload


class PairUnit:
    """Drives of one arm; the surface of `sim.server.ArmUnit`.

    Parameters
    ----------
    arm : cell's description
    world : common physics
    index : 0 master, 1 slave
    bus : its SYNC period and pacing; in real time there is no wait for the other bus

    Attributes
    ----------
    name, world, drives
    instruments : measuring devices on the same bus
    """

    #: Short: each bus waits at its SYNC until the other one has reached the same time.
    real_step_s = 0.001

    def __init__(self, arm: ArmSpec, world: TwoArms, index: int, bus: CellBus) -> None:
        self.name, self.world, self._index = arm.name, world, index
        self._lockstep = bus.pacing != "real"
        self.send: Callable[[can.Message], None] = lambda _message: None
        #: What is to be sent once the instant of a SYNC is over.
        self._answers: list[can.Message] | None = None
        axes = world.motors.axes[world.of_arm[index]]
        self.drives = [
            FakeDrive(spec.node_id, spec, axis, bus.sync_period_s, self._send)  # type: ignore[arg-type]
            for spec, axis in zip(arm.axes, axes, strict=True)
        ]
        self.instruments: list[FakeMeasuringDevice] = []
        world.before.append(self._plan)
        world.after.append(self._advanced)
        self._measure()

    def _send(self, message: can.Message) -> None:
        if self._answers is None:
            self.send(message)
        else:
            self._answers.append(message)

    def _measure(self) -> None:
        for drive, reading in zip(self.drives, self.world.reading_nm(self._index), strict=True):
            drive.reading_nm = reading

    def sync(self) -> None:
        """A SYNC came: once the physics is where it has to be, take the setpoints, send what is mapped to it."""
        if self._lockstep:
            self.world.catch_up(self._index)
            self.world.arrive(self._index)
            self._answer()
            return
        with self.world.settled(self._index):
            self._answers = []
            self._answer()
            answers, self._answers = self._answers, None
        for message in answers:
            self.send(message)

    def _answer(self) -> None:
        self._measure()
        for device in (*self.drives, *self.instruments):
            device.sync()

    def advance(self, seconds: float) -> None:
        """Let simulated time pass, as soon as the other arm's bus lets it pass too."""
        if self._lockstep:
            self.world.ask(self._index, seconds)
        else:
            self.world.follow_the_clock(self._index, seconds)

    def mount(self, payload: Payload) -> None:
        """A pair holds its workpiece and nothing else.

        Raises
        ------
        ValueError : always
        """
        raise ValueError(f"arm {self.name} holds the workpiece; load {payload.label} cannot be mounted on it")

    def _plan(self, ticks: float) -> None:
        for drive in self.drives:
            drive.motion.plan(ticks)

    def _advanced(self, time_s: float) -> None:
        for drive in self.drives:
            drive.advanced(time_s)
