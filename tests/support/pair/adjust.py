"""Position adjustment at one taught point: the hand yields until the force between the arms has gone (fig. 5, S2, S3).

`c <- c + K_c h` per control cycle, K_c a compliance with `0 < K_c K_tot < 1`, at most 1 mm/s. What is stored in the
end are the COMMANDS: a command that produces no force already holds servo sag and the winding up of the gears, which an
encoder on the motor does not see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats

Verdict = Literal["running", "done", "too_far", "too_long"]


@dataclass(frozen=True, slots=True)
class AdjustmentRule:
    """When an adjustment is done, and when it is given up.

    Attributes
    ----------
    force_n, moment_nm : below both for `samples` cycles in a row it is done
    compliance : (m/N, rad/Nm) per control cycle
    speed_m_s, speed_rad_s : fastest change
    largest_m, largest_rad : a larger correction is an error, not an adjustment
    time_s : longest duration
    """

    force_n: float = 3.0
    moment_nm: float = 1.0
    compliance: tuple[float, float] = (2.0e-7, 8.0e-6)
    samples: int = 10
    speed_m_s: float = 1.0e-3
    speed_rad_s: float = 5.0e-3
    largest_m: float = 20.0e-3
    largest_rad: float = 50.0e-3
    time_s: float = 30.0


class Adjustment:
    """One adjustment; step it once per control cycle.

    Parameters
    ----------
    rule : AdjustmentRule
    dt_s : float
    chain_stiffness : array of shape (6, 6)
        Between the hands, `[N/m; Nm/rad]`.
    loop_time_s : float
        How late the force answers to a command.
    hands : int
        How many hands yield, 1 or 2; with two each takes half.

    Raises
    ------
    ConfigError
        The compliance would overshoot or oscillate.
    """

    def __init__(
        self, rule: AdjustmentRule, dt_s: float, chain_stiffness: ArrayLike, loop_time_s: float, hands: int = 1
    ) -> None:
        self._gain = np.repeat(np.asarray(rule.compliance, dtype=float), 3) / hands
        root = np.sqrt(hands * self._gain)
        stiffness = np.asarray(chain_stiffness, dtype=float)
        loop = float(np.linalg.eigvalsh(root[:, None] * (0.5 * (stiffness + stiffness.T)) * root)[-1])
        allowed = min(1.0, dt_s / (1.3 * 2.0 / np.pi * loop_time_s))
        if not 0.0 < loop < allowed:
            raise ConfigError(
                f"position adjustment: compliance times stiffness is {loop:.3g} per cycle, it must lie between 0 and"
                f" {allowed:.3g} at a loop time of {1e3 * loop_time_s:.0f} ms"
            )
        self._rule, self._dt_s = rule, dt_s
        self._correction = np.zeros(6)
        self._quiet, self._cycles = 0, 0

    @property
    def correction(self) -> Floats:
        """Present correction (6,) [m, rad] of each yielding hand (the master takes it with the other sign)."""
        return self._correction.copy()

    def step(self, wrench: ArrayLike) -> Verdict:
        """Move on by one control cycle under the internal wrench (6,) [N, Nm] at the hand."""
        rule, deviation = self._rule, np.asarray(wrench, dtype=float)
        self._cycles += 1
        quiet = np.linalg.norm(deviation[:3]) <= rule.force_n and np.linalg.norm(deviation[3:]) <= rule.moment_nm
        self._quiet = self._quiet + 1 if quiet else 0
        if self._quiet >= rule.samples:
            return "done"
        if self._cycles * self._dt_s > rule.time_s:
            return "too_long"
        change = self._gain * deviation
        for part, fastest in ((slice(0, 3), rule.speed_m_s), (slice(3, 6), rule.speed_rad_s)):
            size = float(np.linalg.norm(change[part]))
            change[part] *= min(1.0, fastest * self._dt_s / max(size, 1e-300))
        self._correction = self._correction + change
        far_m, far_rad = np.linalg.norm(self._correction[:3]), np.linalg.norm(self._correction[3:])
        return "too_far" if far_m > rule.largest_m or far_rad > rule.largest_rad else "running"
