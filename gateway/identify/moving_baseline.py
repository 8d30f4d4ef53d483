"""The model to beat: rigid bodies, load, and per axis Coulomb, viscous friction, rotor inertia and offset.

Parameters carry a Gaussian prior. Link parameters: the CAD values of the robot model with a relative standard deviation
(mass; first moment as a fraction of mass x link length; inertia as one of mass x length^2). Without CAD the fit works
on base columns, nearly free. A load on the flange has free mass and first moment and an inertia of the size its torque
allows. A constant offset is held small where no bare rows tell it from the gravity of an unknown load. Of several runs
the Coulomb friction of each may lie off that of all, by what friction scatters from one motion to the next. Every axis
has a gain and a loss that grows with the torque, held to what is ordinary: their columns are of the modelled torque, so
the fit makes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gateway.identify.links import PER_LINK_MOVING, link_prior
from gateway.identify.loads import BARE_LABEL
from gateway.identify.nuisance import NuisancePrior, gain_stds, nuisance_prior
from gateway.model.motion import PER_BODY, MovingRows
from gateway.model.regressor import regressor
from gateway.model.robot import SHORTEST_M

Floats = NDArray[np.float64]

EXACT = 1e-4
TIGHT_OFFSET = 0.003
FREE = 1e-5
SIZE = 1.0
INERTIA_RADIUS_M = 0.2
#: Scatter of the Coulomb friction from one motion to the next, as a share of it (standard deviation).
SCATTER = 0.1
#: Least Coulomb friction [-] over the torque of its axis: below, its scatter is lost in any noise.
LEAST_FRICTION = 1e-3
#: Length of a column below which there is none.
NOTHING_NM = 1e-12
#: Precision of a parameter that is held to a value.
HELD = 1e14


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """Columns (n, N, P) of the model to beat with the prior's mean (P + 2 N,) and precision (P + 2 N,).

    `body` (10 N, P) maps the parameters to those of the N links as the rows of an unloaded arm see them; `loads` gives
    the slice of each label's ten columns; `friction` (N, 4) the columns of each axis (sign, speed, acceleration, one);
    `level` (N, R) the Coulomb friction of each of R runs off that of all, R = 0 where there is one run. The last 2 N
    parameters are the gain and the load friction of every axis, with no columns here. `lines` has, for each axis, which
    columns reach it and those columns (n, k); `sums` what fits have summed over rows, by the rows.
    """

    columns: Floats
    mean: Floats
    precision: Floats
    body: Floats
    loads: Mapping[str, slice]
    friction: NDArray[np.int_]
    level: NDArray[np.int_]
    trust: float | None
    lines: tuple[tuple[NDArray[np.int_], Floats], ...]
    sums: dict[bytes, Floats] = field(repr=False, default_factory=dict)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.columns.shape[1]

    @property
    def carried(self) -> int:
        """Number of leading parameters that are bodies, links or loads: what the axes carry."""
        return int(self.friction.min())

    @property
    def gain(self) -> NDArray[np.int_]:
        """Where the gain (N,) of every axis stands among the parameters."""
        return self.columns.shape[2] + np.arange(self.axes)

    @property
    def loss(self) -> NDArray[np.int_]:
        """Where the load friction (N,) of every axis stands among the parameters."""
        return self.columns.shape[2] + self.axes + np.arange(self.axes)

    def held(self, index: int, value: float) -> Baseline:
        """The same with one parameter held to a value."""
        mean, precision = self.mean.copy(), self.precision.copy()
        mean[index], precision[index] = value, HELD
        return replace(self, mean=mean, precision=precision)

    def trusting(self, motion: MovingRows, trust: float) -> Baseline:
        """The same with CAD values, which it had before, trusted to another relative standard deviation."""
        mean, precision = self.mean.copy(), self.precision.copy()
        _, own_mean, own_precision = _bodies(motion, trust)
        mean[: len(own_mean)], precision[: len(own_mean)] = own_mean, own_precision
        return replace(self, mean=mean, precision=precision, trust=trust)


def ordinary(motion: MovingRows, gain_std: Floats | None = None) -> NuisancePrior:
    """What every arm has, nothing of its losses being seen; `gain_std` (N,), None = of a table that states none."""
    axes = motion.robot.axes
    nothing = np.full(axes, np.nan)
    return nuisance_prior(gain_stds(None, axes) if gain_std is None else gain_std, nothing, nothing)


def baseline(
    motion: MovingRows,
    trust: float | None,
    known: Mapping[str, tuple[float, Floats]],
    usual: NuisancePrior | None = None,
) -> Baseline:
    """Build the columns.

    Parameters
    ----------
    motion : MovingRows
    trust : float or None
        Relative standard deviation of the CAD values; None = link parameters unknown.
    known : mapping of label to (mass [kg], centre of mass (3,) [m] in the last link)
    usual : NuisancePrior, optional
        Gains and load frictions that are ordinary; as of a table that states nothing if left out.
    """
    usual = ordinary(motion) if usual is None else usual
    labels = free_labels(motion, trust, known)
    body, mean, precision = _bodies(motion, trust)
    columns = [motion.rigid @ body]
    means, precisions = [mean], [precision]
    count = body.shape[1]
    loads: dict[str, slice] = {}
    for label in labels:
        part, load_mean, load_precision = _load(motion, label, known.get(label))
        columns.append(part)
        means.append(load_mean)
        precisions.append(load_precision)
        loads[label] = slice(count, count + PER_BODY)
        count += PER_BODY
    bare = (motion.load[~motion.given] == BARE_LABEL).any()
    friction_columns, friction_precision, where = _friction(motion, bool(labels) and not bare, count)
    level_columns, level_precision, level = _levels(motion, count + friction_columns.shape[2])
    columns += [friction_columns, level_columns]
    means.append(np.zeros(friction_columns.shape[2] + level_columns.shape[2]))
    precisions += [friction_precision, level_precision]
    means += [usual.gain, usual.load_friction]
    precisions += [usual.gain_std**-2.0, usual.load_friction_std**-2.0]
    all_columns = np.concatenate(columns, axis=2)
    padded = np.zeros((body.shape[0], all_columns.shape[2]))
    padded[:, : body.shape[1]] = body
    lines = tuple(_line(all_columns[:, axis]) for axis in range(motion.axes))
    mean, precision = np.concatenate(means), np.concatenate(precisions)
    return Baseline(all_columns, mean, precision, padded, loads, where, level, trust, lines)


def _line(columns: Floats) -> tuple[NDArray[np.int_], Floats]:
    """Which columns (n, P) of one axis are there, and those."""
    there = np.flatnonzero(np.abs(columns).max(axis=0) > 0)
    return there, np.ascontiguousarray(columns[:, there])


def free_labels(motion: MovingRows, trust: float | None, known: Mapping[str, tuple[float, Floats]]) -> list[str]:
    """Labels that get columns of their own: without CAD and bare rows the first load lumps with the last link."""
    fitted = motion.load[~motion.given]
    labels = [
        str(label) for label in np.unique(motion.load) if label != BARE_LABEL and (label in fitted or label in known)
    ]
    if trust is None and not (fitted == BARE_LABEL).any() and not any(label in known for label in labels):
        return labels[1:]
    return labels


def _bodies(motion: MovingRows, trust: float | None) -> tuple[Floats, Floats, Floats]:
    seen = np.flatnonzero(np.abs(motion.rigid).max(axis=(0, 1)) > 1e-12)
    body = np.eye(motion.robot.axes * PER_BODY)[:, seen]
    if trust is None:
        return body, np.zeros(len(seen)), _plausible_size(motion)[seen] ** -2.0
    mean, deviation = link_prior(motion.robot, max(trust, EXACT), PER_LINK_MOVING)
    return body, mean[seen], deviation[seen] ** -2.0


def _plausible_size(motion: MovingRows) -> Floats:
    """Standard deviation (10 N,) of the parameters of links nothing is known of, from the torque the arm needs.

    A body of the mass that the strongest axis holds at half the reach, on every link, as large as the link.
    """
    onward = np.linalg.norm(motion.robot.placement[1:, :3, 3], axis=1)
    reach = max(float(onward.sum()), SHORTEST_M)
    gravity = max(float(np.linalg.norm(motion.gravity_m_s2)), 1.0)
    mass = SIZE * float(_torque_scale(motion).max()) / (gravity * 0.5 * reach)
    length = np.maximum(np.append(onward, 0.0), 0.15 * reach)
    powers = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    return (mass * length[:, None] ** powers).reshape(-1)


def _torque_scale(motion: MovingRows) -> Floats:
    fitted = ~motion.given
    scale = np.sqrt((motion.tau_nm[fitted] ** 2).mean(axis=0))
    return np.where(scale > 0, scale, 1.0)


def _nearly_free(motion: MovingRows, columns: Floats) -> Floats:
    """Precision (P,) under which each column alone may give a thousand times the torque of its strongest axis."""
    relative = np.sqrt(((columns / _torque_scale(motion)[:, None]) ** 2).mean(axis=0)).max(axis=0)
    return np.maximum((FREE * 1e2 * relative) ** 2, 1e-18)


def _load(motion: MovingRows, label: str, known: tuple[float, Floats] | None) -> tuple[Floats, Floats, Floats]:
    here = (motion.load == label)[:, None, None]
    columns = motion.rigid[:, :, -PER_BODY:] * here
    mean, precision = np.zeros(PER_BODY), _nearly_free(motion, columns)
    heaviest = _torque_scale(motion).max() / 9.80665
    precision[4:] = (heaviest * INERTIA_RADIUS_M**2) ** -2.0
    if known is not None:
        mass, com = known
        mean[:4] = np.concatenate([[mass], mass * np.asarray(com)])
        precision[:4] = (1e-4 * max(mass, 1e-3)) ** -2.0
    return columns, mean, precision


def _friction(motion: MovingRows, loaded: bool, first: int) -> tuple[Floats, Floats, NDArray[np.int_]]:
    axes = motion.robot.axes
    columns = np.zeros((len(motion), axes, 4 * axes))
    precision = np.zeros(4 * axes)
    scale = _torque_scale(motion)
    carries = _carries_gravity(motion)
    for axis in range(axes):
        own = _own_friction(motion, axis)
        columns[:, axis, 4 * axis : 4 * axis + 4] = own
        relative = np.sqrt((own**2).mean(axis=0)) / scale[axis]
        precision[4 * axis : 4 * axis + 4] = np.maximum((FREE * 1e2 * relative) ** 2, 1e-18)
        if loaded and carries[axis]:
            precision[4 * axis + 3] = (TIGHT_OFFSET * scale[axis]) ** -2.0
    return columns, precision, first + np.arange(4 * axes).reshape(axes, 4)


def _levels(motion: MovingRows, first: int) -> tuple[Floats, Floats, NDArray[np.int_]]:
    """Columns (n, N, N R) of the Coulomb friction of each run off that of all, and what they are held to."""
    axes, runs = motion.axes, np.unique(motion.run[~motion.given])
    runs = runs if len(runs) > 1 else runs[:0]
    columns = np.zeros((len(motion), axes, axes * len(runs)))
    precision = np.zeros(axes * len(runs))
    where = np.arange(axes * len(runs)).reshape(axes, len(runs))
    for axis, own in enumerate(where):
        columns[:, axis, own] = motion.sign[:, [axis]] * (motion.run[:, None] == runs)
        if len(runs):
            precision[own] = (SCATTER * _coulomb_nm(motion, axis)) ** -2.0
    return columns, precision, first + where


def _coulomb_nm(motion: MovingRows, axis: int) -> float:
    """Coulomb friction [Nm] of one axis, no less than what is lost in any noise."""
    least = LEAST_FRICTION * float(_torque_scale(motion)[axis])
    moves = bool((motion.judged[:, axis] & ~motion.given).any())
    return max(abs(axis_alone(motion, axis)[0]), least) if moves else least


def axis_alone(motion: MovingRows, axis: int, more: Sequence[Floats] = ()) -> tuple[float, Floats]:
    """Coulomb friction [Nm] and residual (k,) of the fitted rows of one axis, by a fit of that axis alone in which its
    links, its loads and further columns (n, m) are free.
    """
    rows = motion.judged[:, axis] & ~motion.given
    bodies = motion.rigid[:, axis]
    # a load left out would pass for noise where two of them differ
    labels = np.setdiff1d(motion.load[~motion.given], [BARE_LABEL])
    loaded = [bodies[:, -PER_BODY:] * (motion.load == label)[:, None] for label in labels]
    matrix = np.column_stack([_own_friction(motion, axis), bodies, *loaded, *more])[rows]
    scale = np.linalg.norm(matrix, axis=0)
    there = scale > NOTHING_NM
    target, value = motion.tau_nm[rows, axis], np.zeros(len(scale))
    value[there] = np.linalg.lstsq(matrix[:, there] / scale[there], target, rcond=1e-6)[0] / scale[there]
    return float(value[0]), target - matrix @ value


def _own_friction(motion: MovingRows, axis: int) -> Floats:
    """Columns (n, 4) of Coulomb and viscous friction, rotor inertia and a constant torque of one axis."""
    speed, acceleration = motion.qd_rad_s[:, axis], motion.qdd_rad_s2[:, axis]
    return np.column_stack([motion.sign[:, axis], speed, acceleration, np.ones(len(motion))])


def _carries_gravity(motion: MovingRows) -> NDArray[np.bool_]:
    """Axes (N,) whose torque gravity can enter."""
    rows = np.linspace(0, len(motion) - 1, min(len(motion), 50)).astype(int)
    rest = np.zeros((len(rows), motion.robot.axes))
    still = np.asarray(regressor(motion.robot, motion.q_rad[rows], rest, rest, tuple(motion.gravity_m_s2)))
    strength = np.abs(still).max(axis=(0, 2))
    return strength > 1e-6 * max(float(strength.max()), 1e-12)
