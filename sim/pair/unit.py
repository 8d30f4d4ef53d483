"""One arm of a pair on its bus: drives whose motors are in the common world."""

from __future__ import annotations

import can

from sim.cellfile import ArmSpec, CellBus
from sim.pair.two_arms import TwoArms
from sim.server import Unit


class PairUnit(Unit):
    """Drives of one arm of a pair.

    Parameters
    ----------
    arm : cell's description
    world : common physics
    index : 0 master, 1 slave
    bus : its SYNC period and pacing; in real time there is no wait for the other bus
    """

    def __init__(self, arm: ArmSpec, world: TwoArms, index: int, bus: CellBus) -> None:
        self._index, self._lockstep = index, bus.pacing != "real"
        #: What is to be sent once the instant of a SYNC is over.
        self._answers: list[can.Message] | None = None
        motors = zip(arm.axes, world.motors.axes[world.of_arm[index]], strict=True)
        super().__init__(arm.name, world, [(spec.node_id, spec, axis) for spec, axis in motors], bus.sync_period_s)
        world.before.append(self.plan)
        world.after.append(self.advanced)

    def put(self, message: can.Message) -> None:
        """Send a frame of a device; at the instant of a SYNC in real time, after it."""
        if self._answers is None:
            self.send(message)
        else:
            self._answers.append(message)

    def readings_nm(self) -> list[float]:
        """Return what the drives of this arm measure."""
        return self.world.reading_nm(self._index)

    def sync(self) -> None:
        """A SYNC came: once the physics is where it has to be, take the setpoints, send what is mapped to it."""
        if self._lockstep:
            self.world.catch_up(self._index)
            self.world.arrive(self._index)
            super().sync()
            return
        with self.world.settled(self._index):
            self._answers = []
            super().sync()
            answers, self._answers = self._answers, None
        for message in answers:
            self.send(message)

    def advance(self, seconds: float) -> None:
        """Let simulated time pass, as soon as the other arm's bus lets it pass too."""
        if self._lockstep:
            self.world.ask(self._index, seconds)
        else:
            self.world.follow_the_clock(self._index, seconds)
