"""Columns of a moving run: links, loads, friction, nuisance parameters and effects of the library, with priors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.identify.knowledge import Knowledge
from gateway.identify.links import PER_LINK_AT_REST, PER_LINK_MOVING, body_parameters, link_prior
from gateway.identify.motion.prior import (
    CHANGE,
    FALL,
    FRICTION,
    FRICTION_UNITS,
    RUN,
    change_names,
    fall_columns,
    fall_speeds,
    friction_columns,
    moving_prior,
)
from gateway.identify.nuisance import gain_stds
from gateway.identify.prior_loads import LOAD_NAMES, LOAD_UNITS, refuse_absent, unknown_labels
from gateway.identify.rest.rest_nuisance import occasions_of
from gateway.identify.solve import Prior
from gateway.model.base import BaseSet, base_parameters, moving_base
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.motion import SLOW, SMOOTH_RAD_S, Modelled, MovingRows, time_order
from gateway.model.regressor import full_names, regressor
from gateway.model.robot import Robot
from gateway.model.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Further nuisance parameters: the gain of the reading, a loss that grows with the torque, in proportion or not quite,
#: a reading that lags behind the position, a gain that changes from occasion to occasion, friction that differs by
#: direction, near standstill and from run to run, and loads with inertia.
NUISANCES = ("gain", "load_friction")
_LOCAL = (*NUISANCES, "loss_bend", "delay", CHANGE)
MOVING_NUISANCES = (*_LOCAL, "bias", "uneven_friction", "run_friction", "load_inertia")
#: Prior radius of gyration of a load [m].
_GYRATION_M = 0.2
INERTIA_NAMES = tuple(f"inertia_{name}" for name in ("xx", "xy", "xz", "yy", "yz", "zz"))
_INERTIA_UNITS = ("kg m2",) * len(INERTIA_NAMES)
#: Number of columns of a load: mass and first moment; all ten.
_LOAD, _BODY = slice(-PER_LINK_MOVING, 4 - PER_LINK_MOVING), slice(-PER_LINK_MOVING, None)


@dataclass(frozen=True, slots=True, eq=False)
class SeenEffects:
    """Effects evaluated on the rows of a fit: `rows` are the rows in the order `order` (n,) of the fit."""

    terms: tuple[Term, ...]
    rows: MovingRows
    order: NDArray[np.int_]

    def without(self, terms: tuple[Term, ...]) -> SeenEffects:
        """Return a copy without some of the effects."""
        return replace(self, terms=tuple(term for term in self.terms if term not in terms))

    @property
    def load(self) -> NDArray[np.str_]:
        """Load (n,) of each row of the fit."""
        return self.rows.load[np.argsort(self.order)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the linear parameters."""
        return tuple(
            f"{' '.join((term.name, *(f'J{joint}' for joint in term.joints)))}: {name}"
            for term in self.terms
            for name in term.parameters[: term.count]
        )

    @property
    def std(self) -> Floats:
        """Standard deviation of the prior of each linear parameter about 0, infinite = free."""
        spread = np.array([value for term in self.terms for value in term.spread[: term.count]], dtype=float)
        return np.where(np.isnan(spread), np.inf, spread)

    def columns(self, modelled: Modelled | None) -> Floats:
        """Columns (n, N, k) of the effects; those that depend on the modelled torque need it as argument."""
        out, start = np.zeros((*self.rows.tau_nm.shape, len(self.std))), 0
        for term in self.terms:
            if term.modelled is (modelled is not None):
                own = term.columns(self.rows, modelled)  # type: ignore[arg-type]
                for place, axis in enumerate(term.enters(self.rows.axes)):
                    out[self.order, axis, start : start + term.count] = own[:, place]
            start += term.count
        return out

    def modelled(self, bodies: Floats, load_kg: Floats, value: Floats) -> Modelled:
        """Torque of bodies (n, 10 N) with the effects (k,), for terms that depend on it; loads with masses (n,)."""
        seen, start = bodies[self.order], 0
        for term in self.terms:
            seen += term.bodies(value[start : start + term.count], bodies.shape[1])
            start += term.count
        rigid_nm = np.einsum("nap,np->na", self.rows.rigid, seen)
        return Modelled(rigid_nm, rigid_nm, seen, load_kg[self.order])


@dataclass(frozen=True, slots=True, eq=False)
class Effects:
    """Effects of a fit, and how to evaluate them on the rows of a table."""

    terms: tuple[Term, ...]
    rows_of: Callable[[Table], MovingRows]

    def of_rows(self, moving: Table) -> SeenEffects:
        """Evaluate the effects on the rows of a table."""
        return SeenEffects(self.terms, self.rows_of(moving), time_order(moving)[0])


@dataclass(frozen=True, slots=True)
class MovingSetup:
    """Settings of a fit of moving rows.

    Attributes
    ----------
    smooth_rad_s : float or array of shape (N,)
        Coulomb friction is `tanh(qd / smooth_rad_s)`.
    slow_share : float
        Rows in which an axis is slower than this share of its speed limit are not used on it, of its top speed where no
        limit is stated.
    nuisances : names out of `MOVING_NUISANCES` that every axis or load gets, with their priors
    passes : int or None
        None: axes are weighted by the residual of a fit with free link parameters, which has one answer. A number:
        that many solutions, each axis weighted by its residual in the one before, beginning with equal weights; with
        fixed link parameters this has several fixed points.
    """

    smooth_rad_s: float | Floats = SMOOTH_RAD_S
    slow_share: float = SLOW
    nuisances: tuple[str, ...] = MOVING_NUISANCES
    passes: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of a moving run, with names, units and priors.

    Attributes
    ----------
    design : array of shape (n, N, p)
        Columns of nuisance parameters are 0: they depend on the modelled torque.
    known_nm : array of shape (n, N)
        Torque of exactly known links and loads.
    prior : Prior
    names, units : tuples of p str
    link_columns : int array of shape (k,)
        Which of the 10 N link parameters the first k columns belong to.
    to_links : array of shape (10 N, k)
        The link parameters by the first k, inseparable ones set to one choice of many.
    fixed_links : array of shape (10 N,)
        Parameters of links that are known exactly, 0 elsewhere.
    known : parameters (10,) of each load that is known
    loads : first column of each load
    bodies : how many of the first columns are torque of bodies, which a gain multiplies
    nuisances : columns (N,) of nuisance parameters, by their names; of a change of gain one for each occasion
    occasions : run and load of each occasion
    occasion : int array (n,) of each row
    sign : array of shape (n, N)
        Rounded sign of the speed.
    smooth_rad_s : float or array of shape (N,)
        By which it is rounded.
    falls_rad_s : array of shape (N, k)
        Speeds over which friction falls from breakaway, each a column; k = 0: none.
    effects : SeenEffects or None
        Effects with columns of their own, which come last; those that depend on the modelled torque are 0.
    taken : int array
        Nuisance parameters that an effect replaces: without prior and without limit.
    parts : as of `Knowledge`
    """

    design: Floats
    known_nm: Floats
    prior: Prior
    names: tuple[str, ...]
    units: tuple[str, ...]
    link_columns: Ints
    to_links: Floats
    fixed_links: Floats
    known: dict[str, Floats]
    loads: dict[str, int]
    bodies: int
    nuisances: dict[str, Ints]
    occasions: tuple[tuple[str, ...], ...]
    occasion: Ints
    sign: Floats
    smooth_rad_s: float | Floats
    falls_rad_s: Floats
    effects: SeenEffects | None = None
    taken: Ints = field(default_factory=lambda: np.zeros(0, dtype=int))
    parts: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    def with_effects(self, seen: SeenEffects | None) -> Columns:
        """Return the columns with effects; an effect replaces the nuisance parameter that it exceeds."""
        if seen is None:
            return self
        usual = {term: self.usual_of(term) for term in seen.terms}
        own = seen.without(tuple(term for term, index in usual.items() if index is not None))
        more = Prior(np.zeros(len(own.std)), own.std, np.zeros((0, len(own.std))), np.zeros(0))
        return replace(
            self,
            design=np.concatenate([self.design, own.columns(None)], axis=2),
            prior=self.prior.beside(more),
            names=(*self.names, *own.names),
            units=(*self.units, *[""] * len(own.names)),
            effects=own,
            taken=np.array([index for index in usual.values() if index is not None], dtype=int),
        )

    def usual_of(self, term: Term) -> int | None:
        """Indices of the nuisance parameters that belong to an effect."""
        return int(self.nuisances[term.takes_over][term.joints[0] - 1]) if term.takes_over in self.nuisances else None

    def by_effects(self, value: Floats) -> Floats | None:
        """Columns (n, N, k) of effects that depend on the bodies' torque for parameters (p,), if there are any."""
        if self.effects is None or not any(term.modelled for term in self.effects.terms):
            return None
        bodies, load_kg = self.bodies_of(value, self.effects.load)
        return self.effects.columns(self.effects.modelled(bodies, load_kg, value[-len(self.effects.std) :]))

    def bodies_of(self, value: Floats, load: NDArray[np.str_]) -> tuple[Floats, Floats]:
        """Parameters (n, 10 N) of the bodies under the loads (n,), with the load in the last link; mass (n,) of the
        loads.
        """
        links = self.fixed_links + self.to_links @ value[self.links]
        bodies, load_kg = np.tile(links, (len(load), 1)), np.zeros(len(load))
        count = PER_LINK_MOVING if self.inertia else PER_LINK_AT_REST
        first = bodies.shape[1] - PER_LINK_MOVING
        loads = {label: value[place : place + count] for label, place in self.loads.items()}
        for label, own in {**loads, **self.known}.items():
            here = load == label
            bodies[here, first : first + len(own)] += own
            load_kg[here] = own[0]
        return bodies, load_kg

    def dry(self, value: Floats) -> Floats:
        """Coulomb friction (N,) [Nm] in the parameters (p,)."""
        place = {name: k for k, name in enumerate(self.names)}
        at = [place.get(f"coulomb[J{axis + 1}]") for axis in range(self.design.shape[1])]
        return np.array([0.0 if k is None else value[k] for k in at])

    @property
    def first_effect(self) -> int:
        """Index of the first column of effects."""
        return len(self.names) - (0 if self.effects is None else len(self.effects.std))

    @property
    def inertia(self) -> bool:
        """Whether loads have ten columns instead of mass and first moment only."""
        return any(name.startswith(INERTIA_NAMES[0]) for name in self.names)

    @property
    def links(self) -> Ints:
        """Slice of the link columns."""
        return np.arange(min(self.loads.values(), default=self.bodies))

    @property
    def lasting(self) -> Ints:
        """Columns (N, 4) of Coulomb and viscous friction, rotor inertia and a constant torque of each axis."""
        axes, shapes = self.design.shape[1], len(FRICTION)
        return self.bodies + np.arange(axes * shapes).reshape(axes, shapes)

    @property
    def changes(self) -> Ints:
        """Columns (occasions, N) of the change of gain on each occasion."""
        own = [self.nuisances[name] for name in change_names(len(self.occasions)) if name in self.nuisances]
        return np.array(own, dtype=int).reshape(-1, self.design.shape[1])

    @property
    def friction(self) -> Ints:
        """Indices of the friction columns, including the loss proportional to torque."""
        last = min((int(index[0]) for index in self.nuisances.values()), default=len(self.names))
        own = np.arange(self.bodies, last)
        return np.concatenate([own, *(self.nuisances.get(name, own[:0]) for name in ("load_friction", "loss_bend"))])


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Part of the columns (n, N, k), with names and units (k,)."""

    design: Floats
    names: Sequence[str]
    units: Sequence[str]


def moving_columns(moving: Table | MovingRows, robot: Robot, knowledge: Knowledge, motion: MovingSetup) -> Columns:
    """Build the columns of moving rows.

    Raises
    ------
    InputError
        A known load that is not in the data.
    """
    unknown = unknown_labels(moving.load, knowledge.known)
    refuse_absent(moving.load, knowledge.weighed)
    known = {
        label: body_parameters(values[0], np.array(values[1:]), np.zeros((3, 3)))
        for label, values in knowledge.known.items()
    }
    if isinstance(moving, MovingRows):
        rows = moving.rigid
    else:
        rows = regressor(robot, moving.q_rad, moving.qd_rad_s, moving.qdd_rad_s2, knowledge.gravity_m_s2)
    mean, std = link_prior(robot, knowledge.trust, PER_LINK_MOVING)
    held, free = np.flatnonzero((std > 0.0) & np.isfinite(std)), np.flatnonzero(np.isinf(std))
    base, fixed = _free_base(robot, knowledge, free), np.where(std == 0.0, mean, 0.0)
    chosen = np.concatenate([held, free[base.indices]])
    links = _link_block(robot, rows, (held, chosen), base)
    loads = [_load_block(moving, rows, label, motion) for label in unknown]
    bodies = [links, *loads]
    firsts = np.cumsum([len(block.names) for block in bodies])
    falls_rad_s = fall_speeds(moving.qd_rad_s)[:, : None if "uneven_friction" in motion.nuisances else 0]
    own = list(_friction_blocks(moving, _shapes(motion, unknown), motion.smooth_rad_s, falls_rad_s))
    if "run_friction" in motion.nuisances:
        own.append(_run_block(moving, motion.smooth_rad_s))
    first = int(firsts[-1]) + sum(len(block.names) for block in own)
    occasions, occasion = occasions_of(moving)
    local = [name for name in motion.nuisances if name in _LOCAL and name != CHANGE]
    if CHANGE in motion.nuisances:
        local += change_names(len(occasions))
    nuisances = {name: first + k * robot.axes + np.arange(robot.axes) for k, name in enumerate(local)}
    blocks = [*bodies, *own, *(_local_block(len(moving), robot.axes, name) for name in local)]
    names = tuple(name for block in blocks for name in block.names)
    gain_std = gain_stds(knowledge.gain_std, robot.axes)
    prior = moving_prior((mean[held], std[held]), len(names), nuisances, gain_std, knowledge.change)
    places = dict(zip(unknown, firsts[:-1].tolist(), strict=True))
    for label in knowledge.weighed.keys() & places.keys():
        rows_of_load, right = knowledge.weighed[label].rows()
        around = (places[label], len(names) - places[label] - len(LOAD_NAMES))
        prior = replace(
            prior,
            rows=np.vstack([prior.rows, np.pad(rows_of_load, ((0, 0), around))]),
            right=np.append(prior.right, right),
        )
    if "load_inertia" in motion.nuisances:
        for place in places.values():
            prior.std[place + 4 : place + 10] = _heaviest_kg(moving) * _GYRATION_M**2
    return Columns(
        np.concatenate([block.design for block in blocks], axis=2),
        _known_nm(moving, rows, fixed, known),
        prior, names, tuple(unit for block in blocks for unit in block.units), chosen,
        np.eye(len(fixed))[:, chosen], fixed, known, places, int(firsts[-1]), nuisances,
        occasions, occasion,
        np.tanh(moving.qd_rad_s / motion.smooth_rad_s), motion.smooth_rad_s, falls_rad_s,
        parts=knowledge.parts,
    )  # fmt: skip


def _link_block(robot: Robot, rows: Floats, which: tuple[Ints, Ints], base: BaseSet) -> _Block:
    """Columns of links with a prior, and base columns of links without one."""
    held, chosen = which
    full = full_names(robot.axes)
    units = [("kg", *["kg m"] * 3, *["kg m2"] * 6)[k % PER_LINK_MOVING] for k in chosen]
    return _Block(rows[:, :, chosen], [*(full[k] for k in held), *base.names], units)


def _load_block(moving: Table | MovingRows, rows: Floats, label: str, motion: MovingSetup) -> _Block:
    here = (np.asarray(moving.load) == label)[:, None, None]
    if "load_inertia" not in motion.nuisances:
        return _Block(rows[:, :, _LOAD] * here, [f"{name}[{label}]" for name in LOAD_NAMES], LOAD_UNITS)
    names = [f"{name}[{label}]" for name in (*LOAD_NAMES, *INERTIA_NAMES)]
    return _Block(rows[:, :, _BODY] * here, names, (*LOAD_UNITS, *_INERTIA_UNITS))


def _shapes(motion: MovingSetup, unknown: Sequence[str]) -> tuple[str, ...]:
    """Friction columns of each axis; a free offset would absorb the gravity of an unknown load, one with a prior does
    not.
    """
    return FRICTION if "bias" in motion.nuisances or not unknown else FRICTION[:3]


def _friction_blocks(
    moving: Table | MovingRows, shapes: tuple[str, ...], smooth_rad_s: float | Floats, falls_rad_s: Floats
) -> tuple[_Block, _Block]:
    joints = [f"[J{axis + 1}]" for axis in range(moving.axes)]
    units = [FRICTION_UNITS[FRICTION.index(name)] for name in shapes] * len(joints)
    lasting = friction_columns(moving.qd_rad_s, moving.qdd_rad_s2, shapes, smooth_rad_s)
    fading = [f"{FALL}_{k + 1}{joint}" for joint in joints for k in range(falls_rad_s.shape[1])]
    return (
        _Block(lasting, [f"{name}{joint}" for joint in joints for name in shapes], units),
        _Block(fall_columns(moving.qd_rad_s, falls_rad_s, smooth_rad_s), fading, ["Nm"] * len(fading)),
    )


def _run_block(moving: Table | MovingRows, smooth_rad_s: float | Floats) -> _Block:
    """Columns of the Coulomb friction of each of several runs that move an axis, as deviation from the arm's mean."""
    here = np.asarray(moving.run)[:, None] == np.unique(moving.run)
    sign = np.tanh(moving.qd_rad_s / smooth_rad_s)
    moved = [[k for k in range(here.shape[1]) if sign[here[:, k], axis].any()] for axis in range(moving.axes)]
    place = [(axis, k) for axis, runs in enumerate(moved) for k in runs if len(runs) > 1]
    design = np.zeros((*sign.shape, len(place)))
    for column, (axis, k) in enumerate(place):
        design[:, axis, column] = sign[:, axis] * here[:, k]
    return _Block(design, [f"{RUN}_{k + 1}[J{axis + 1}]" for axis, k in place], ["Nm"] * len(place))


def _local_block(rows: int, axes: int, name: str) -> _Block:
    """Columns of the nuisance parameters of each axis, scaled by the modelled torque; zero before the first fit."""
    names = [f"{name}[J{axis + 1}]" for axis in range(axes)]
    return _Block(np.zeros((rows, axes, axes)), names, ["s" if name == "delay" else ""] * axes)


def _known_nm(moving: Table | MovingRows, rows: Floats, fixed: Floats, loads: Mapping[str, Floats]) -> Floats:
    """Torque (n, N) of links with exact parameters `fixed` (10 N,) and of known loads."""
    known = rows @ fixed
    for label, body in loads.items():
        here = np.asarray(moving.load) == label
        known[here] += rows[here][:, :, _BODY] @ body
    return known


def _heaviest_kg(moving: Table | MovingRows) -> float:
    """Mass whose weight at 1 m is the largest torque of all axes."""
    torque = float(np.sqrt(np.nanmean(moving.tau_nm**2, axis=0)).max())
    return torque / float(np.linalg.norm(STANDARD_GRAVITY_M_S2))


def _free_base(robot: Robot, knowledge: Knowledge, free: Ints) -> BaseSet:
    if len(free) == robot.axes * PER_LINK_MOVING:
        return moving_base(robot, knowledge.gravity_m_s2)
    q, qd, qdd = np.random.default_rng(0).uniform(-2.0, 2.0, size=(3, 60, robot.axes))
    rows = regressor(robot, q, qd, qdd, knowledge.gravity_m_s2)[:, :, free]
    return base_parameters(rows, [full_names(robot.axes)[k] for k in free])
