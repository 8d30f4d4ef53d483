"""How far both hands are off while a way is streamed: told by the force in the part, or by distance sensors."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from gateway.data.sample import ArmSample
from gateway.pair.calibration import PathWrenches
from gateway.pair.follow import WrenchFromTorque
from gateway.pair.gap import GapWatch
from gateway.pair.guard import ForceGuard
from gateway.pair.transform import Floats

Samples = tuple[ArmSample, ...]


class Felt(Protocol):
    """What a stream asks, cycle by cycle, and what it has gathered in the end (see `motion.Streamed`)."""

    force: Floats
    external_nm: Floats
    gaps_m: Floats

    def listen(self, samples: Samples) -> None:
        """Take in a cycle at standstill, before the way begins."""
        ...

    def inputs(self, m: int) -> tuple[Floats | None, Floats | None]:
        """What the commander is told for command m."""
        ...

    def take(self, m: int, samples: Samples, rate: float = 1.0) -> str:
        """Take in what was measured at the SYNC of command m; why both arms must stop, "" = they need not.

        `rate` is how fast time passes along the path.
        """
        ...

    def size_n(self, m: int) -> float:
        """Force inside the part at command m [N]; 0 where nothing feels it."""
        ...

    def doubtful(self, m: int) -> bool:
        """Whether what was felt at command m may be friction, where joints come to rest."""
        ...


class FeltByForce:
    """Wrenches of both arms from their torques, and a limit for the force inside the part.

    Parameters
    ----------
    wrenches : of both arms along the way
    maps : of the way
    guard : ForceGuard
    doubt_n : a force that friction may feign [N]
    """

    def __init__(
        self,
        wrenches: tuple[WrenchFromTorque, WrenchFromTorque],
        maps: PathWrenches,
        guard: ForceGuard,
        doubt_n: float = 0.0,
    ) -> None:
        count = wrenches[0].count
        self.force, self.external_nm = np.zeros((count, 6)), np.full((count, 2, 6), np.nan)
        self.gaps_m = np.zeros((count, 0))
        self._wrenches, self._maps, self._guard, self._count = wrenches, maps, guard, count
        self._doubt_n = doubt_n
        for each in wrenches:
            each.reset()

    def listen(self, samples: Samples) -> None:
        """Torques become wrenches, so that a way begins with forces and not without."""
        for each, sample in zip(self._wrenches, samples, strict=True):
            each.update(0, sample)

    def inputs(self, m: int) -> tuple[Floats | None, Floats | None]:
        """Both wrenches (6,) [N, Nm], base axes."""
        return self._wrenches[0].wrench, self._wrenches[1].wrench

    def size_n(self, m: int) -> float:
        """As `Felt.size_n`."""
        return float(np.linalg.norm(self.force[m, :3]))

    def doubtful(self, m: int) -> bool:
        """As `Felt.doubtful`."""
        return self.size_n(m) < self._doubt_n

    def take(self, m: int, samples: Samples, rate: float = 1.0) -> str:
        """As `Felt.take`."""
        for index, (each, sample) in enumerate(zip(self._wrenches, samples, strict=True)):
            each.update(m, sample, rate)
            if m and each.external_nm is not None:
                self.external_nm[m - 1, index] = each.external_nm
        felt = self._maps.internal(m, *self.inputs(m))
        if felt is None:
            return ""
        self.force[m] = felt
        size_n = self.size_n(m)
        if not self._guard.step(size_n):
            return ""
        return (
            f"the force inside the part was above {self._guard.threshold_n:.0f} N for more than"
            f" {1e3 * self._guard.time_s:.0f} ms ({size_n:.0f} N at command {m + 1} of {self._count}):"
            " both arms stop; release the part before moving on, then teach again or lower the speed"
        )


class FeltByDistance:
    """What the slave's fingertip still has to move, from distance sensors; their limits are watched by the motion.

    Parameters
    ----------
    watch : GapWatch
        Already takes in every cycle.
    slave : array of shape (M, 4, 4)
        Nominal commands of the slave along the way.
    """

    def __init__(self, watch: GapWatch, slave: Floats) -> None:
        count = len(slave)
        self.force, self.external_nm = np.zeros((count, 6)), np.full((count, 2, 6), np.nan)
        self.gaps_m = np.full((count, len(watch.layout.estimator.demanded_m)), np.nan)
        self._watch, self._slave = watch, slave

    def listen(self, samples: Samples) -> None:
        """Nothing to do: the watch has listened."""

    def inputs(self, m: int) -> tuple[Floats | None, Floats | None]:
        """None, and the move (6,) [m, rad] in the slave's base axes; None too where the last SYNC had no value."""
        readings = self._watch.readings_m
        if readings is None:
            return None, None
        return None, self._watch.layout.estimator.error_in_base(readings, self._slave[m])

    def size_n(self, m: int) -> float:
        """0: nothing is held in common."""
        return 0.0

    def doubtful(self, m: int) -> bool:
        """Never: a distance is what it is, at rest too."""
        return False

    def take(self, m: int, samples: Samples, rate: float = 1.0) -> str:
        """As `Felt.take`."""
        if self._watch.readings_m is not None:
            self.gaps_m[m] = self._watch.readings_m - self._watch.layout.estimator.demanded_m
        return ""
