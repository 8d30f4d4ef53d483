"""Gear losses: presliding, bias by direction, losses that grow with load, efficiency by direction, warm-up.

After a slow approach the friction of a joint is at its kinetic level. While the controller settles, the joint creeps
back by a small distance, and within the presliding range friction decreases exponentially with that distance (Dahl
1968): from the kinetic level `F` to `F (2 exp(-s / s0) - 1)`. What is left is scattered further from stop to stop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.levels import Harshness

Array = NDArray[np.float64]

#: Shape of the gamma distribution of the creep distance.
CREEP_SHAPE = 2.0


@dataclass(frozen=True, slots=True)
class Friction:
    """Losses of the gears of one arm; arrays (N,) unless stated otherwise.

    Attributes
    ----------
    coulomb_nm : warm kinetic friction of the unloaded gear
    bias_share, bias_std : half the difference between directions over the band; its standard deviation over arms
    load_loss, load_power, rated_nm : `load_loss * rated * (|tau| / rated) ** load_power` is added to the band
    driving, driven : residual efficiency where the motor drives, where it is driven back
    efficiency_std, split_std : standard deviations over arms of their mean, and of half their difference
    declared_efficiency : stated by the owner; the true one is that times the residual
    warm_share, warm_s : (2, N) and (2,) excess of the cold band, and time constants
    creep : mean creep distance over the presliding length
    tail_freedom, tail_share, side_correlation : scatter of the band from stop to stop, Student's
    outlier_share : share of the visits with an outlier on one axis
    """

    coulomb_nm: Array
    bias_share: Array
    bias_std: float
    load_loss: Array
    load_power: Array
    rated_nm: Array
    driving: Array
    driven: Array
    efficiency_std: float
    split_std: float
    declared_efficiency: Array
    warm_share: Array
    warm_s: Array
    creep: Array
    tail_freedom: float
    tail_share: Array
    side_correlation: float
    outlier_share: float

    @property
    def left_std(self) -> Array:
        """Return the standard deviation (N,) of the share of the kinetic level at rest."""
        # of 2 exp(-s) - 1 for a gamma-distributed s of shape k and mean c
        first = (1.0 + self.creep / CREEP_SHAPE) ** -CREEP_SHAPE
        second = (1.0 + 2.0 * self.creep / CREEP_SHAPE) ** -CREEP_SHAPE
        return 2.0 * np.sqrt(second - first**2)

    def half_sum_std_nm(self, band_nm: Array, cold_nm: Array) -> Array:
        """Standard deviation of half the sum of both sides, for bands and cold unloaded bands of any shape (..., N)."""
        scatter = self.tail_share * cold_nm * np.sqrt(1.0 + self.side_correlation)
        return np.hypot(self.left_std * band_nm, scatter) / np.sqrt(2.0)

    @property
    def mean_left(self) -> Array:
        """Return the mean share (N,) of the kinetic level at rest."""
        return 2.0 * (1.0 + self.creep / CREEP_SHAPE) ** -CREEP_SHAPE - 1.0

    def band_nm(self, tau_nm: Array, time_s: Array) -> Array:
        """Kinetic friction (n, N) at transmitted torques (n, N) and times (n,)."""
        load = self.load_loss * self.rated_nm * (np.abs(tau_nm) / self.rated_nm) ** self.load_power
        return self.coulomb_nm * self.cold(time_s) + load

    def cold(self, time_s: Array) -> Array:
        """Factor (n, N) on the unloaded band at times (n,)."""
        fading = np.exp(-np.asarray(time_s)[:, None] / self.warm_s)
        return 1.0 + fading @ self.warm_share

    def motor_nm(self, behind_nm: Array, direction: Array) -> Array:
        """Motor torque (n, N), joint side, of the torque behind the gear in motion in `direction` (n,) or (n, N)."""
        drives = behind_nm * direction.reshape(len(behind_nm), -1) > 0
        forth, back = self.declared_efficiency * self.driving, self.declared_efficiency * self.driven
        return np.where(drives, behind_nm / forth, behind_nm * back)

    def stops(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the friction at rest of `count` visits: share left of the kinetic level and scatter, (count, 2, N)
        each.
        """
        axes = len(self.coulomb_nm)
        way = rng.gamma(CREEP_SHAPE, self.creep / CREEP_SHAPE, (count, 2, axes))
        rho = self.side_correlation
        normal = rng.standard_normal((count, 2, axes))
        normal[:, 1] = rho * normal[:, 0] + np.sqrt(1.0 - rho**2) * normal[:, 1]
        # one chi-square for both sides of a visit: a rough stop is rough from both sides
        chi = rng.chisquare(self.tail_freedom, (count, 1, axes)) / (self.tail_freedom - 2.0)
        return 2.0 * np.exp(-way) - 1.0, self.tail_share * normal / np.sqrt(chi)


def draw_friction(rated_nm: Array, levels: Harshness, rng: np.random.Generator) -> Friction:
    """Friction of the gears of an arm of rated torques (N,)."""
    axes = len(rated_nm)
    efficiency = rng.uniform(*levels.efficiency, axes)
    split_std = float(rng.uniform(*levels.efficiency_split))
    split = split_std * rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), axes)
    driving, driven = np.minimum(efficiency + split, 1.0), np.minimum(efficiency - split, 1.0)
    size = rng.uniform(*levels.bias_share, axes)
    low, high = levels.bias_share
    warm = rng.uniform(*levels.warm_share, axes) * np.array([[1.0], [0.0]])
    fast = rng.uniform(0.2, 0.8, axes)
    declared = np.ones(axes) if rng.random() < 0.5 else np.round(rng.uniform(0.82, 0.96, axes), 3)
    return Friction(
        coulomb_nm=rated_nm * np.exp(rng.uniform(np.log(0.012), np.log(0.06), axes)),
        bias_share=size * rng.choice([-1.0, 1.0], axes),
        bias_std=float(np.sqrt((low**2 + low * high + high**2) / 3.0)),
        load_loss=rng.uniform(*levels.load_loss, axes),
        load_power=rng.uniform(0.85, 1.15, axes),
        rated_nm=rated_nm,
        driving=driving,
        driven=driven,
        efficiency_std=(levels.efficiency[1] - levels.efficiency[0]) / np.sqrt(12.0),
        split_std=split_std,
        declared_efficiency=declared,
        warm_share=np.vstack([warm[0] * fast, warm[0] * (1.0 - fast)]),
        warm_s=np.array([rng.uniform(90.0, 400.0), rng.uniform(900.0, 3600.0)]),
        creep=rng.uniform(0.04, 0.16, axes),
        tail_freedom=float(rng.uniform(*levels.tail_freedom)),
        tail_share=rng.uniform(*levels.tail_share, axes),
        side_correlation=float(rng.uniform(*levels.side_correlation) * rng.choice([-1.0, 1.0])),
        outlier_share=float(rng.uniform(*levels.outlier_share)),
    )
