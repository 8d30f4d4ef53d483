"""Columns of a moving run: links, loads, friction, with what is known of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import LOAD_NAMES, LOAD_UNITS
from gateway.identify.links import PER_LINK_MOVING, body_parameters, link_prior
from gateway.identify.loads import unknown_labels
from gateway.identify.nuisance import BIAS_SHARE, gain_stds, nuisance_prior
from gateway.identify.solve import Prior
from gateway.model.base import BaseSet, base_parameters, moving_base
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.regressor import full_names, regressor
from gateway.model.robot import Robot

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

FRICTION = ("coulomb", "viscous", "rotor_inertia", "offset")
#: What every arm has beside: the reading's gain, a loss in proportion to the torque, a reading that lags behind the
#: position, friction that differs by direction and near standstill, and loads that are no points.
ORDINARY = ("gain", "load_friction", "delay", "uneven_friction", "load_inertia")
NUISANCES = ORDINARY[:2]
_LOCAL = ORDINARY[:3]
#: Speed [rad/s] over which friction falls to its Coulomb level where none shows, and the share of that level by which.
_FALLS_RAD_S, _FALL_SHARE = 0.05, 0.3
#: Standard deviation [s] of a delay of which nothing is known: filters of a drive, a few SYNCs.
_DELAY_S = 0.02
#: Radius of gyration of a load [m], and its six numbers among a body's ten.
_GYRATION_M, _INERTIA = 0.2, slice(4 - PER_LINK_MOVING, None)
INERTIA_NAMES = tuple(f"inertia_{name}" for name in ("xx", "xy", "xz", "yy", "yz", "zz"))
FRICTION_UNITS = ("Nm", "Nm s/rad", "kg m2", "Nm")
#: Of the last link: mass and first moment; all ten.
_LOAD, _BODY = slice(-PER_LINK_MOVING, 4 - PER_LINK_MOVING), slice(-PER_LINK_MOVING, None)


@dataclass(frozen=True, slots=True)
class MovingSetup:
    """How a moving run is fitted.

    Attributes
    ----------
    smooth_rad_s : float
        Coulomb friction is `tanh(qd / smooth_rad_s)`.
    slow_share : float
        Rows slower than this share of an axis's speed limit are not used on it; an axis without a limit uses all.
    friction : names out of `FRICTION` that every axis gets, or None
        None: all of them, without the offset where a load is unknown, because a free offset swallows gravity.
    ordinary : names out of `ORDINARY` that every axis or load gets, with their priors
    passes : int or None
        None: axes are weighted by the residual of a fit with free link parameters, which has one answer. A number:
        that many solutions, each axis weighted by its residual in the one before, beginning with equal weights; with
        fixed link parameters this has several fixed points.
    stribeck_rad_s : N floats, or none
        Speed over which the friction of an axis falls from breakaway; NaN: it does not.
    """

    smooth_rad_s: float = 0.02
    slow_share: float = 0.01
    friction: tuple[str, ...] | None = None
    ordinary: tuple[str, ...] = ORDINARY
    passes: int | None = None
    stribeck_rad_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of a moving run.

    Attributes
    ----------
    design : array of shape (n, N, p)
        Those of what every arm has are 0: they are of the modelled torque.
    known_nm : array of shape (n, N)
        Torque of what is known exactly.
    prior : Prior
    names, units : tuples of p str
    loads : first column of each load
    bodies : how many of the first columns are torque of bodies, which a gain multiplies
    ordinary : columns (N,) of what every arm has, by its name
    sign : array of shape (n, N)
        Rounded sign of the speed.
    smooth_rad_s : float
        By which it is rounded.
    stribeck_rad_s : N floats
        Speed over which friction falls from breakaway; NaN where an axis has no such column.
    """

    design: Floats
    known_nm: Floats
    prior: Prior
    names: tuple[str, ...]
    units: tuple[str, ...]
    loads: dict[str, int]
    bodies: int
    ordinary: dict[str, Ints]
    sign: Floats
    smooth_rad_s: float
    stribeck_rad_s: tuple[float, ...]

    def dry(self, value: Floats) -> Floats:
        """Coulomb friction (N,) [Nm] among the parameters (p,)."""
        place = {name: k for k, name in enumerate(self.names)}
        at = [place.get(f"coulomb[J{axis + 1}]") for axis in range(self.design.shape[1])]
        return np.array([0.0 if k is None else value[k] for k in at])

    @property
    def inertia(self) -> bool:
        """Whether loads have all ten columns, not mass and first moment alone."""
        return any(name.startswith(INERTIA_NAMES[0]) for name in self.names)

    @property
    def links(self) -> Ints:
        """Columns of the links."""
        return np.arange(min(self.loads.values(), default=self.bodies))

    @property
    def friction(self) -> Ints:
        """Columns of friction, the loss in proportion to the torque among them."""
        last = min((int(index[0]) for index in self.ordinary.values()), default=len(self.names))
        own = np.arange(self.bodies, last)
        return np.concatenate([own, self.ordinary.get("load_friction", own[:0])])


def fast_rows(qd_rad_s: Floats, robot: Robot, motion: MovingSetup) -> Mask:
    """Which axes (n, N) move fast enough to be used."""
    limit = np.where(np.isfinite(robot.velocity_rad_s), robot.velocity_rad_s, 0.0)
    return np.abs(qd_rad_s) >= motion.slow_share * limit


def moving_columns(moving: Table, robot: Robot, options: EstimateOptions, motion: MovingSetup) -> Columns:
    """Columns of the moving rows of a table.

    Raises
    ------
    InputError
        A known load that is not in the data.
    """
    unknown = unknown_labels(moving.load, options.known)
    rows = regressor(robot, moving.q_rad, moving.qd_rad_s, moving.qdd_rad_s2, options.gravity_m_s2)
    mean, std = link_prior(robot, options.trust, PER_LINK_MOVING)
    fixed = np.where(std == 0.0, mean, 0.0)
    held = np.flatnonzero((std > 0.0) & np.isfinite(std))
    free = np.flatnonzero(np.isinf(std))
    base = _free_base(robot, options, free)
    chosen = np.concatenate([held, free[base.indices]])
    known = rows @ fixed
    for label, values in options.known.items():
        here = np.asarray(moving.load) == label
        known[here] += rows[here][:, :, _BODY] @ body_parameters(values[0], np.array(values[1:]), np.zeros((3, 3)))
    full = full_names(robot.axes)
    parts, names, units = [rows[:, :, chosen]], [*(full[k] for k in held), *base.names], []
    units += [("kg", *["kg m"] * 3, *["kg m2"] * 6)[k % PER_LINK_MOVING] for k in chosen]
    loads: dict[str, int] = {}
    for label in unknown:
        loads[label] = len(names)
        here = (np.asarray(moving.load) == label)[:, None, None]
        parts.append(rows[:, :, _LOAD] * here)
        names += [f"{name}[{label}]" for name in LOAD_NAMES]
        units += LOAD_UNITS
        if "load_inertia" in motion.ordinary:
            parts.append(rows[:, :, _INERTIA] * here)
            names += [f"{name}[{label}]" for name in INERTIA_NAMES]
            units += ["kg m2"] * len(INERTIA_NAMES)
    bodies = len(names)
    uneven = "uneven_friction" in motion.ordinary
    stribeck = np.asarray(motion.stribeck_rad_s or (np.nan,) * robot.axes, dtype=float)
    stribeck = np.where(np.isnan(stribeck), _FALLS_RAD_S, stribeck) if uneven else stribeck
    falls = np.flatnonzero(np.isfinite(stribeck))
    shapes = motion.friction or (FRICTION if uneven or not loads else FRICTION[:3])
    parts.append(_friction_columns(moving, shapes, motion.smooth_rad_s))
    names += [f"{name}[J{axis + 1}]" for axis in range(robot.axes) for name in shapes]
    units += [FRICTION_UNITS[FRICTION.index(name)] for _ in range(robot.axes) for name in shapes]
    parts.append(_stribeck_columns(moving, stribeck, motion.smooth_rad_s)[:, :, falls])
    names += [f"stribeck[J{axis + 1}]" for axis in falls]
    units += ["Nm"] * len(falls)
    ordinary: dict[str, Ints] = {}
    for name in (name for name in motion.ordinary if name in _LOCAL):
        ordinary[name] = len(names) + np.arange(robot.axes)
        names += [f"{name}[J{axis + 1}]" for axis in range(robot.axes)]
        units += ["s" if name == "delay" else ""] * robot.axes
        parts.append(np.zeros((len(moving.q_rad), robot.axes, robot.axes)))
    prior = _prior((mean[held], std[held]), len(names), ordinary, gain_stds(options.gain_std, robot.axes))
    if "load_inertia" in motion.ordinary:
        heaviest = float(np.sqrt(np.nanmean(moving.tau_nm**2, axis=0)).max()) / float(
            np.linalg.norm(STANDARD_GRAVITY_M_S2)
        )
        for first in loads.values():
            prior.std[first + 4 : first + 10] = heaviest * _GYRATION_M**2
    return Columns(
        np.concatenate(parts, axis=2), known, prior, tuple(names), tuple(units), loads, bodies, ordinary,
        np.tanh(moving.qd_rad_s / motion.smooth_rad_s), motion.smooth_rad_s, tuple(stribeck.tolist()),
    )  # fmt: skip


def _prior(links: tuple[Floats, Floats], count: int, ordinary: dict[str, Ints], gain_std: Floats) -> Prior:
    """Prior of held links, mean and standard deviation, and of what every arm has."""
    prior, nothing = Prior.free(count), np.full(len(gain_std), np.nan)
    held = len(links[0])
    prior.mean[:held], prior.std[:held] = links
    usual = nuisance_prior(gain_std, nothing, nothing)
    for name, index in ordinary.items():
        if name == "delay":
            prior.std[index] = _DELAY_S
        else:
            prior.mean[index], prior.std[index] = getattr(usual, name), getattr(usual, f"{name}_std")
    return prior


def held_to_friction(columns: Columns, level_nm: Floats) -> Columns:
    """The columns with what is a share of the Coulomb friction (N,) held to that.

    A fall towards standstill; and a constant torque where a load is unknown, because a free one swallows gravity.
    """
    std = columns.prior.std.copy()
    for k, name in enumerate(columns.names):
        kind, _, axis = name.partition("[J")
        if kind == "stribeck":
            std[k] = _FALL_SHARE * level_nm[int(axis[:-1]) - 1]
        elif kind == "offset" and columns.loads:
            std[k] = BIAS_SHARE * level_nm[int(axis[:-1]) - 1]
    return replace(columns, prior=replace(columns.prior, std=std))


def _free_base(robot: Robot, options: EstimateOptions, free: Ints) -> BaseSet:
    if len(free) == robot.axes * PER_LINK_MOVING:
        return moving_base(robot, options.gravity_m_s2)
    q, qd, qdd = np.random.default_rng(0).uniform(-2.0, 2.0, size=(3, 60, robot.axes))
    rows = regressor(robot, q, qd, qdd, options.gravity_m_s2)[:, :, free]
    return base_parameters(rows, [full_names(robot.axes)[k] for k in free])


def _friction_columns(moving: Table, shapes: tuple[str, ...], smooth_rad_s: float) -> Floats:
    (n, axes), count = moving.q_rad.shape, len(shapes)
    values = {
        "coulomb": np.tanh(moving.qd_rad_s / smooth_rad_s),
        "viscous": moving.qd_rad_s,
        "rotor_inertia": moving.qdd_rad_s2,
        "offset": np.ones((n, axes)),
    }
    out = np.zeros((n, axes, axes * count))
    for axis in range(axes):
        for k, name in enumerate(shapes):
            out[:, axis, axis * count + k] = values[name][:, axis]
    return out


def _stribeck_columns(moving: Table, speed_rad_s: tuple[float, ...], smooth_rad_s: float) -> Floats:
    out = np.zeros((*moving.q_rad.shape, moving.axes))
    for axis, speed in enumerate(speed_rad_s):
        if np.isfinite(speed):
            qd = moving.qd_rad_s[:, axis]
            out[:, axis, axis] = np.tanh(qd / smooth_rad_s) * np.exp(-((qd / speed) ** 2))
    return out
