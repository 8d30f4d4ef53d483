"""Deviation of both hands during a trajectory: from the internal force, or from distance sensors."""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

import numpy as np

from gateway.data.visit import ArmSample
from gateway.pair.balance import ForceBalance
from gateway.pair.force import DELAY_MEMORY_S, ForceGuard, cause_of
from gateway.pair.gap import GapWatch
from gateway.pair.joint_targets import ExternalTorque
from gateway.pair.transform import Floats

Samples = tuple[ArmSample, ...]
#: Largest distance from the start of a trajectory at which the holding torques there still give the force [rad].
NEAR_RAD = 5e-3


class Deviation(Protocol):
    """Interface of the deviation estimate, called every cycle, and its result (see `Streamed`)."""

    force: Floats
    gaps_m: Floats

    def listen(self, samples: Samples) -> None:
        """Process one cycle at standstill, before the trajectory begins."""
        ...

    def inputs(self, m: int) -> tuple[Floats | None, Floats | None]:
        """Return the inputs of the commander for command m."""
        ...

    def take(self, m: int, samples: Samples, rate: float = 1.0) -> str:
        """Take in what was measured at the SYNC of command m; why both arms must stop, "" = they need not.

        `rate` is how fast time passes along the path.
        """
        ...

    def size_n(self, m: int) -> float:
        """Return the internal force at command m [N]; 0 where it is not measured."""
        ...

    def doubtful(self, m: int) -> bool:
        """Return whether the force at command m may be friction, where joints come to rest."""
        ...


class DeviationFromForce:
    """Wrenches of both hands from the joint torques of both arms, with a limit of the internal force.

    Parameters
    ----------
    arms : torques of both along the way
    balance : ForceBalance of the way, begun
    guard : ForceGuard
    still : ForceGuard
        During the approach to the start, where no force is expected.
    dt_s : control cycle
    friction_uncertainty_n : a force that friction may simulate [N]
    """

    def __init__(
        self,
        arms: tuple[ExternalTorque, ExternalTorque],
        balance: ForceBalance,
        guard: ForceGuard,
        still: ForceGuard,
        dt_s: float,
        friction_uncertainty_n: float = 0.0,
    ) -> None:
        self.force = np.zeros((balance.count, 6))
        self.gaps_m = np.zeros((balance.count, 0))
        self._arms, self._balance = arms, balance
        self._guard, self._still = guard, still
        self._dt_s, self._friction_uncertainty_n = dt_s, friction_uncertainty_n
        #: Numbers of the last SYNCs that were taken in, and when they were sent [s].
        self._sent: deque[tuple[int, float]] = deque(maxlen=1 + math.ceil(DELAY_MEMORY_S / dt_s))

    def _update(self, m: int, samples: Samples, rate: float, row: int | None) -> None:
        self._sent.append((samples[0].sync_index, samples[0].time_s))
        first, second = (arm.update(m, sample, rate) for arm, sample in zip(self._arms, samples, strict=True))
        self._balance.take(m, (first, second), row)

    def listen(self, samples: Samples) -> None:
        """Convert torques to wrenches, so that forces are available at the start of a trajectory."""
        self._update(0, samples, 1.0, None)

    def rest(self, samples: Samples) -> str:
        """Take one cycle of the approach to the start; return why both arms must stop, "" = continue.

        Only near the beginning: its weights are known.
        """
        away = [np.abs(sample.q_rad - arm.q_rad[0]).max() for arm, sample in zip(self._arms, samples, strict=True)]
        if max(away) > NEAR_RAD:
            return ""
        self.listen(samples)
        if self._balance.wrench is None:
            return ""
        force = self._balance.wrench[:3]
        size_n = float(np.linalg.norm(force))
        along = force / size_n if size_n > 0.0 else force
        std_n = math.sqrt(along @ self._balance.covariance[:3, :3] @ along)
        if not self._still.step(size_n - 2.0 * std_n):
            return ""
        return (
            f"the internal force rose to {size_n:.0f} N during the approach to the start, above"
            f" {self._still.threshold_n:g} N: both arms stop; a part that is held is gripped elsewhere than the"
            " function has it: open the grippers, check the grasp of both arms, then close them at the start"
        )

    def inputs(self, m: int) -> tuple[Floats | None, Floats | None]:
        """Return both wrenches (6,) [N, Nm], base axes."""
        return self._balance.inputs(m) or (None, None)

    def size_n(self, m: int) -> float:
        """As `Deviation.size_n`."""
        return float(np.linalg.norm(self.force[m, :3]))

    def doubtful(self, m: int) -> bool:
        """As `Deviation.doubtful`."""
        return self.size_n(m) < self._friction_uncertainty_n

    def take(self, m: int, samples: Samples, rate: float = 1.0) -> str:
        """As `Deviation.take`."""
        self._update(m, samples, rate, m - 1 if m else None)
        if self._balance.wrench is None:
            return ""
        self.force[m] = self._balance.wrench
        size_n = self.size_n(m)
        # a SYNC without data does not prove that a force persists; long gaps stop the arm for another reason
        if not self._balance.fresh or not self._guard.step(size_n):
            return ""
        return (
            f"the internal force was above {self._guard.threshold_n:.0f} N for more than"
            f" {1e3 * self._guard.time_s:.0f} ms ({size_n:.0f} N at command {m + 1} of {self._balance.count}):"
            f" both arms stop; release the part before moving on; {self._cause(m)}"
        )

    def _cause(self, m: int) -> str:
        delay_s = float(np.ptp([sent_s - self._dt_s * index for index, sent_s in self._sent]))
        force_n = np.linalg.norm(self.force[: m + 1, :3], axis=1)
        return cause_of(force_n, self._guard.threshold_n, self._dt_s, delay_s)


class DeviationFromDistance:
    """Remaining displacement of the slave's fingertip from distance sensors; the motion monitors their limits.

    Parameters
    ----------
    watch : GapWatch
        Already takes every cycle.
    slave : array of shape (M, 4, 4)
        Nominal commands of the slave along the trajectory.
    """

    def __init__(self, watch: GapWatch, slave: Floats) -> None:
        count = len(slave)
        self.force = np.zeros((count, 6))
        self.gaps_m = np.full((count, len(watch.layout.estimator.demanded_m)), np.nan)
        self._watch, self._slave = watch, slave

    def listen(self, samples: Samples) -> None:
        """Do nothing: the gap monitor processes every cycle."""

    def inputs(self, m: int) -> tuple[Floats | None, Floats | None]:
        """Return None and the displacement (6,) [m, rad] in the slave's base axes; None without a valid distance."""
        readings = self._watch.readings_m
        if readings is None:
            return None, None
        return None, self._watch.layout.estimator.error_in_base(readings, self._slave[m])

    def size_n(self, m: int) -> float:
        """Return 0: no common part."""
        return 0.0

    def doubtful(self, m: int) -> bool:
        """Return False: distances are not affected by friction."""
        return False

    def take(self, m: int, samples: Samples, rate: float = 1.0) -> str:
        """As `Deviation.take`."""
        if self._watch.readings_m is not None:
            self.gaps_m[m] = self._watch.readings_m - self._watch.layout.estimator.demanded_m
        return ""
