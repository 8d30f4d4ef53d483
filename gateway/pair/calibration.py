"""Calibration of the cell for the coordination, and linear maps of wrenches and poses along a path."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from gateway.errors import ConfigError
from gateway.pair.force import GRAVITY_M_S2, share_of_part, to_centre
from gateway.pair.learning_update import Bases
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats, inverse

#: Chain of gears and part of the reference cell: [N/m], [Nm/rad].
TYPICAL_STIFFNESS = (1.6e5, 3.6e3)
TYPICAL_LOOP_TIME_S = 0.035


def _typical_stiffness() -> Floats:
    return np.diag(np.repeat(TYPICAL_STIFFNESS, 3))


@dataclass(frozen=True, slots=True, eq=False)
class PairCalibration:
    """Calibration data of the cell used by the controller.

    Attributes
    ----------
    w_t_b1, w_t_b2 : arrays of shape (4, 4)
        Bases of master and slave in the world [m].
    e1_t_part : array of shape (4, 4)
        Part's centre in gripper 1.
    part_mass_kg : 0 = unknown; half of it is assumed at each gripper.
    gravity_m_s2 : array of shape (3,), world axes.
    chain_stiffness : array of shape (6, 6)
        Of gears and part between the hands about fingertip 2, `[N/m; Nm/rad]`.
    loop_time_s : servo lag + bus delay + force filter + half a cycle.
    force_limit_n : limit of the internal force; above it learning is faster.
    """

    w_t_b1: Floats
    w_t_b2: Floats
    e1_t_part: Floats
    part_mass_kg: float = 0.0
    gravity_m_s2: Floats = field(default_factory=lambda: np.array(GRAVITY_M_S2))
    chain_stiffness: Floats = field(default_factory=_typical_stiffness)
    loop_time_s: float = TYPICAL_LOOP_TIME_S
    force_limit_n: float = math.inf

    def __post_init__(self) -> None:
        for name in ("w_t_b1", "w_t_b2", "e1_t_part"):
            value = np.asarray(getattr(self, name), dtype=float)
            proper = value.shape == (4, 4) and np.isfinite(value).all()
            if not proper or np.abs(value[:3, :3].T @ value[:3, :3] - np.eye(3)).max() > 1e-6:
                raise ConfigError(f"pair calibration: {name} is not a pose (4, 4)")
        if not (self.part_mass_kg >= 0.0 and self.loop_time_s > 0.0):
            raise ConfigError("pair calibration: part mass must not be negative, loop time must be positive")

    @property
    def bases(self) -> Bases:
        """Return both bases in the world."""
        return Bases(self.w_t_b1, self.w_t_b2)


class PathWrenches:
    """Linear maps along a path between the wrenches at the fingertips and the internal wrench.

    Parameters
    ----------
    calibration : PairCalibration
    path : PairPath
    slave : array of shape (M, 4, 4)
        Slave's commands, for the lever to its fingertip (millimetres do not matter here).
    """

    def __init__(self, calibration: PairCalibration, path: PairPath, slave: Floats) -> None:
        centre = (calibration.w_t_b1 @ path.commands @ calibration.e1_t_part)[:, :3, 3]
        self._to_centre: list[Floats] = []
        #: Wrench (M, 6, 6) at either fingertip, base axes, of one about the part's centre.
        self.from_centre: list[Floats] = []
        #: What half a part of 1 kg does to either hand, about its centre (M, 6), and what half of this one does.
        self.share_per_kg: list[Floats] = []
        self.share: list[Floats] = []
        speed = np.gradient(centre, path.dt_s, axis=0)
        force = share_of_part(1.0, np.gradient(speed, path.dt_s, axis=0), calibration.gravity_m_s2)
        self.part_mass_kg = calibration.part_mass_kg
        for base, commands in ((calibration.w_t_b1, path.commands), (calibration.w_t_b2, slave)):
            lever = (base @ commands)[:, :3, 3] - centre
            self._to_centre.append(to_centre(base[:3, :3], lever))
            self.from_centre.append(to_centre(base[:3, :3].T, -lever @ base[:3, :3]))
            self.share_per_kg.append(np.concatenate([force, np.cross(lever, force)], axis=1))
            self.share.append(calibration.part_mass_kg * self.share_per_kg[-1])

    def internal(self, m: int, first: Floats | None, second: Floats | None) -> Floats | None:
        """Internal wrench (6,) about the part's centre, world axes [N, Nm], from wrenches at the fingertips.

        With one arm's wrench alone, that less its share of the part; None without any.
        """
        one = None if first is None else self._to_centre[0][m] @ first - self.share[0][m]
        two = None if second is None else self._to_centre[1][m] @ second - self.share[1][m]
        if one is None:
            return two
        return -one if two is None else 0.5 * (two - one)

    def at_tip(self, arm: int, m: int, internal: Floats) -> Floats:
        """Wrench (6,) at a fingertip, base axes of that arm (0 master, 1 slave), of one about the part's centre."""
        return self.from_centre[arm][m] @ internal


def calibration_of(w_t_b1: Floats, w_t_b2: Floats, part_t_e1: Floats) -> PairCalibration:
    """Return the calibration of a cell with typical values of stiffness, loop time and part mass."""
    return PairCalibration(w_t_b1, w_t_b2, inverse(part_t_e1))
