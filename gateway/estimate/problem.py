"""Rest visits and a robot as the weighted linear problem of links, loads, gains, torque offsets and friction sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.gains import GainRows
from gateway.estimate.options import EstimateOptions
from gateway.identify.links import PER_LINK_AT_REST, link_prior
from gateway.identify.loads import bare_and_gain_rows, load_vector, unknown_labels
from gateway.identify.solve import Prior
from gateway.model.base import BaseSet, rest_base
from gateway.model.regressor import LOAD_COLUMNS, gravity_names, gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.result.result import Bare

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

LOAD_NAMES = ("mass", "hx", "hy", "hz")
LOAD_UNITS = ("kg", "kg m", "kg m", "kg m")
#: Prior standard deviation of the friction of a one-sided approach, as a share of the axis's torque.
FRICTION_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Knowledge of the 4 N link parameters [m, hx, hy, hz].

    `fixed` (4 N,) is what is taken as known exactly (0 elsewhere); `held` are columns with a Gaussian prior `mean`,
    `std` (4 N,); `base` are the combinations of the free ones, `free` their columns.
    """

    fixed: Floats
    mean: Floats
    std: Floats
    held: Ints
    free: Ints
    base: BaseSet

    @property
    def columns(self) -> Ints:
        """Columns of the 4 N that stand for parameters: held ones, then independent free ones."""
        return np.concatenate([self.held, self.free[self.base.indices]])

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each of `columns`; a free one names what it lumps."""
        return (*(gravity_names(len(self.mean) // PER_LINK_AT_REST)[k] for k in self.held), *self.base.names)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Rows (measured axis of a visit) and columns of one estimation.

    Attributes
    ----------
    visits : Visits
    visit, axis : int arrays of shape (r,)
        Where each row comes from.
    design : array of shape (r, p)
    target : array of shape (r,)
        Torque less known loads and known links [Nm].
    prior : Prior
    names, units : p names
    links : Links
        The first `len(links.columns)` parameters.
    loads : label -> first of its four columns
    offsets : int array of shape (k,)
        Columns of the torque offsets, one per measured axis.
    offset_axis : int array of shape (k,)
    gains : int array of shape (k,)
        Columns of the gains, one per measured axis, in the same order.
    sided : int array of shape (s,)
        Axes that have one-sided rows.
    losses : int array of shape (s,)
        Columns of their load friction, in the same order.
    known_nm : array of shape (r,)
        What is known of the torque.
    """

    visits: Visits
    visit: Ints
    axis: Ints
    design: Floats
    target: Floats
    prior: Prior
    names: tuple[str, ...]
    units: tuple[str, ...]
    links: Links
    loads: dict[str, int]
    offsets: Ints
    offset_axis: Ints
    gains: Ints
    sided: Ints
    losses: Ints
    known_nm: Floats

    @property
    def rows(self) -> GainRows:
        """The rows without their gains and load friction."""
        axis_place = np.searchsorted(self.offset_axis, self.axis)
        loss = direction = None
        if len(self.sided):
            place = np.minimum(np.searchsorted(self.sided, self.axis), len(self.sided) - 1)
            loss = self.losses[place]
            known = self.sided[place] == self.axis
            direction = np.where(known, self.visits.direction[self.visit, self.axis], 0).astype(float)
        return GainRows(
            self.design,
            self.visits.tau_nm[self.visit, self.axis],
            self.known_nm,
            int(self.offsets[0]),
            self.gains[axis_place],
            loss,
            direction,
        )


def link_knowledge(robot: Robot, options: EstimateOptions) -> Links:
    """What the robot model's inertials say, at the trust of the options."""
    mean, std = link_prior(robot, options.trust, PER_LINK_AT_REST)
    open_ = np.isinf(std)
    fixed = np.where(std == 0.0, mean, 0.0)
    held = np.flatnonzero((std > 0.0) & ~open_)
    free = np.flatnonzero(open_)
    base = rest_base(robot, options.gravity_m_s2, free.tolist())
    return Links(fixed, mean, std, held, free, base)


def build_problem(visits: Visits, robot: Robot, options: EstimateOptions) -> Problem:
    """Assemble rows and columns.

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        Nothing was measured at rest.
    """
    measured = np.isfinite(visits.tau_nm)
    if not measured.any():
        raise DataUnusable(
            "no axis torque was measured at rest; a pose number and a torque or current column are needed"
        )
    visit, axis = np.nonzero(measured)
    rows = gravity_regressor(robot, visits.q_rad, options.gravity_m_s2)[visit, axis]
    links = link_knowledge(robot, options)
    labels = unknown_labels(visits.load, options.known)
    known = rows @ links.fixed
    for label, values in options.known.items():
        here = visits.load[visit] == label
        known[here] += rows[here, LOAD_COLUMNS] @ load_vector(values)
    parts, names, units = [rows[:, links.columns]], list(links.names), _link_units(links)
    loads: dict[str, int] = {}
    for label in labels:
        loads[label] = len(names)
        parts.append(rows[:, LOAD_COLUMNS] * (visits.load[visit] == label)[:, None])
        names += [f"{name}[{label}]" for name in LOAD_NAMES]
        units += LOAD_UNITS
    offset_axis = np.flatnonzero(measured.any(axis=0))
    offsets = len(names) + np.arange(len(offset_axis))
    parts.append((axis[:, None] == offset_axis).astype(float))
    names += [f"offset[J{k + 1}]" for k in offset_axis]
    units += ["Nm"] * len(offset_axis)
    gains = len(names) + np.arange(len(offset_axis))
    parts.append(np.zeros((len(axis), len(gains))))
    names += [f"gain[J{k + 1}]" for k in offset_axis]
    units += ["1"] * len(offset_axis)
    sided = _sided_axes(visits, measured)
    parts.append(np.where(axis[:, None] == sided, visits.direction[visit, axis][:, None], 0.0))
    names += [f"friction[J{k + 1}]" for k in sided]
    units += ["Nm"] * len(sided)
    losses = len(names) + np.arange(len(sided))
    parts.append(np.zeros((len(axis), len(sided))))
    names += [f"loss[J{k + 1}]" for k in sided]
    units += ["1"] * len(sided)
    return Problem(
        visits=visits,
        visit=visit,
        axis=axis,
        design=np.hstack(parts),
        target=visits.tau_nm[visit, axis] - known,
        prior=_prior(links, options.bare, len(names), gains, offset_axis).with_std(
            gains[-1] + 1 + np.arange(len(sided)), FRICTION_SHARE * _torque_rms(visits)[sided]
        ),
        names=tuple(names),
        units=tuple(units),
        links=links,
        loads=loads,
        offsets=offsets,
        offset_axis=offset_axis,
        gains=gains,
        sided=sided,
        losses=losses,
        known_nm=known,
    )


def _link_units(links: Links) -> list[str]:
    return ["kg" if column % 4 == 0 else "kg m" for column in links.columns]


def _sided_axes(visits: Visits, measured: NDArray[np.bool_]) -> Ints:
    """Axes that were approached from a known side alone: their friction is in the torque."""
    one_sided = measured & (visits.direction != 0)
    return np.flatnonzero(one_sided.any(axis=0))


def _torque_rms(visits: Visits) -> Floats:
    """Root mean square (N,) of each axis's torque; 0 where not measured."""
    count = np.isfinite(visits.tau_nm).sum(axis=0)
    return np.sqrt(np.nansum(visits.tau_nm**2, axis=0) / np.maximum(count, 1))


def _prior(links: Links, bare: Bare | None, count: int, gains: Ints, gain_axis: Ints) -> Prior:
    prior = Prior.free(count)
    held = len(links.held)
    mean, std = prior.mean, prior.std
    mean[:held], std[:held] = links.mean[links.held], links.std[links.held]
    if bare is None:
        return Prior(mean, std, prior.rows, prior.right)
    rows, right = bare_and_gain_rows(bare)
    further = np.zeros((len(rows), count))
    count_links = len(links.fixed)
    further[:, : len(links.columns)] = rows[:, links.columns]
    further[:, gains] = rows[:, count_links + gain_axis]
    return Prior(mean, std, further, right - rows[:, :count_links] @ links.fixed)
