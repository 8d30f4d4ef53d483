"""Best possible estimate of a load from a moving run: the Bayesian linear model, given all but the numbers.

Links, load, torque constants, friction, rotors, delays, cogging and the scatter of every stroke are columns with the
priors of the arm. Load, friction, rotors and delays have none. The noise is weighed by its spectrum.
The model is evaluated at the truth, on the mean over the periods; regressors are pinocchio's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from benchmarks.nature.moving_arm import SHORTEST_LINK_M, MovingArm
from benchmarks.nature.moving_cell import PeriodicMotion, friction_nm
from sim.engine import Engine
from sim.urdf import SimChain, write_chain

Floats = NDArray[np.float64]

PER_BODY = 10
#: Standard deviation of what has no prior, in sizes of its own true value.
FREE = 1e3
#: The same of a delay [s] and of a loss with load.
FREE_DELAY_S, FREE_LOSS = 0.1, 1.0
STEP = 1e-4


class Cell(Protocol):
    """What the oracle needs of a cell."""

    @property
    def arm(self) -> MovingArm:
        """The arm as it is."""
        ...

    @property
    def motion(self) -> PeriodicMotion:
        """The motion of every run."""
        ...

    @property
    def start_s(self) -> dict[str, float]:
        """Label of every run and when it begins."""
        ...

    @property
    def link_std(self) -> float:
        """Relative standard deviation of the links."""
        ...


@dataclass(frozen=True, slots=True)
class _Run:
    """True states of one period under one load, (n, N) each.

    `behind` is the torque behind the gear, `drives` where the motor gives power, `through` the motor's torque over it;
    `regressor` (n, N, 10 N) is the motor's.
    """

    q: Floats
    qd: Floats
    qdd: Floats
    tau: Floats
    behind: Floats
    drives: Floats
    through: Floats
    regressor: Floats
    time_s: Floats
    loaded: bool


def oracle_std(cell: Cell) -> dict[str, Floats]:
    """Standard deviation of the load's ten numbers, under `load`, and of every axis's (N,) by quantity."""
    arm = cell.arm
    axes = len(arm.rated_nm)
    shared, columns = _columns(cell)
    first = [int(index[shared]) for index, _ in columns]
    information = _information(columns)
    load_std = _load_scale(arm)
    covariance = np.linalg.inv(information)
    load = covariance[shared - PER_BODY : shared, shared - PER_BODY : shared] * np.outer(load_std, load_std)
    std = np.sqrt(np.diag(covariance))
    sizes = _own_sizes(arm)
    out = {
        name: np.array([std[first[axis] + place] for axis in range(axes)]) * size
        for place, (name, size) in enumerate(sizes.items())
    }
    jacobian = _differentiated(about_centre, _parameters(arm))
    return out | {"load": np.sqrt(np.diag(jacobian @ load @ jacobian.T))}


def beyond_nuisances(cell: Cell, added_nm: Mapping[str, Floats]) -> Floats:
    """Return how far (N,) a torque is beyond everything that has a column here, in standard deviations of all rows.

    `added_nm` is the torque (periods, n, N) that is added in the run of each label. What differs from the mean over the
    periods has no column.
    """
    arm, motion, runs = cell.arm, cell.motion, len(cell.start_s)
    _, columns = _columns(cell)
    mean = np.concatenate([added_nm[label].mean(axis=0) for label in cell.start_s])
    targets = [_whitened(arm, axis, mean[:, [axis]], motion, runs)[:, 0] for axis in range(mean.shape[1])]
    drawn = np.zeros(columns[-1][0][-1] + 1)
    for (index, white), target in zip(columns, targets, strict=True):
        drawn[index] += white.T @ target
    value = np.linalg.solve(_information(columns), drawn)
    out = np.array(
        [np.sum((t - white @ value[index]) ** 2) for (index, white), t in zip(columns, targets, strict=True)]
    )
    for number in range(motion.periods):
        off = np.concatenate([added_nm[label][number] for label in cell.start_s]) - mean
        single = [_whitened(arm, axis, off[:, [axis]], motion, runs) for axis in range(off.shape[1])]
        # of one period: its noise has `periods` times the variance of the mean's
        out += np.array([np.sum(part**2) for part in single]) / motion.periods
    return np.sqrt(out)


def _columns(cell: Cell) -> tuple[int, list[tuple[NDArray[np.int_], Floats]]]:
    """Return how many columns all axes share, and for each axis the places and whitened columns of its rows."""
    arm, motion = cell.arm, cell.motion
    runs = [_run(cell, label) for label in cell.start_s]
    bodies, load_std = _link_columns(arm, cell.link_std), _load_scale(arm)
    first = shared = bodies.shape[1] + PER_BODY
    columns = []
    for axis in range(len(arm.rated_nm)):
        part = _axis_columns(arm, runs, axis, motion)
        body = np.concatenate([run.regressor[:, axis] @ bodies for run in runs])
        load = np.concatenate([run.loaded * run.regressor[:, axis, -PER_BODY:] * load_std for run in runs])
        index = np.concatenate([np.arange(shared), np.arange(first, first + part.shape[1])])
        columns.append((index, _whitened(arm, axis, np.hstack([body, load, part]), motion, len(runs))))
        first += part.shape[1]
    return shared, columns


def _information(columns: list[tuple[NDArray[np.int_], Floats]]) -> Floats:
    """Information of all rows and priors about the columns."""
    out = np.eye(columns[-1][0][-1] + 1)
    for index, white in columns:
        out[np.ix_(index, index)] += white.T @ white
    return out


def about_centre(parameters: Floats) -> Floats:
    """Mass, centre of gravity and inertia about it (10,), of [m, h, I about the origin (xx, xy, yy, xz, yz, zz)]."""
    mass, com = parameters[0], parameters[1:4] / parameters[0]
    xx, xy, yy, xz, yz, zz = parameters[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *com, *np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]])


def _parameters(arm: MovingArm) -> Floats:
    tool = arm.tool
    return pinocchio.Inertia(tool.mass_kg, tool.com_m, tool.inertia_kg_m2).toDynamicParameters()


def _load_scale(arm: MovingArm) -> Floats:
    """Standard deviations (10,) of a load of which nothing is known."""
    mass, length = arm.tool.mass_kg, 1.0
    return FREE * mass * np.array([1.0, *[length] * 3, *[length**2] * 6])


def _run(cell: Cell, label: str) -> _Run:
    arm, motion = cell.arm, cell.motion
    times = np.arange(motion.samples) / motion.rate_hz
    q, qd, qdd = (np.asarray(part) for part in motion.states(times)[:3])
    with Engine([arm.carrying(label)], arm.gravity_m_s2) as dynamics:
        tau = dynamics.torque_nm(q, qd, qdd)
    model = pinocchio.buildModelFromXML(write_chain(_free(arm.chain)))
    model.gravity.linear = arm.gravity_m_s2
    data = model.createData()
    rows = zip(q, qd, qdd, strict=True)
    regressor = np.array([pinocchio.computeJointTorqueRegressor(model, data, *row).copy() for row in rows])
    time_s = np.full(len(times), cell.start_s[label] + 0.5 * motion.periods * motion.period_s)
    behind = tau + friction_nm(arm, qd, tau, np.ones_like(qd), time_s) + arm.rotor_inertia_kg_m2 * qdd
    drives = behind * qd > 0
    efficiency = arm.friction.declared_efficiency
    through = np.where(drives, 1.0 / efficiency, efficiency)
    return _Run(q, qd, qdd, tau, behind, drives, through, through[:, :, None] * regressor, time_s, label != "none")


def _free(chain: SimChain) -> SimChain:
    """The chain with limits so far off that every library takes its joints for joints that turn."""
    wide = np.full(len(chain.axis), 1e3)
    return replace(chain, lower_rad=-wide, upper_rad=wide, effort_nm=wide, velocity_rad_s=wide)


def _link_columns(arm: MovingArm, trust: float) -> Floats:
    """Parameters (10 N, 5 N) of the links per unit of what they were drawn with: mass, centre, size of the inertia."""
    chain = arm.chain
    axes = len(chain.axis)
    out = np.zeros((PER_BODY * axes, 5 * axes))
    for link, body in enumerate(chain.bodies):
        if body is None:
            raise ValueError("every link of a drawn arm has an inertial")
        onward = float(np.linalg.norm(chain.placement[min(link + 1, axes - 1), :3, 3]))
        length = max(onward, float(np.linalg.norm(body.com_m)), SHORTEST_LINK_M)

        def parameters(off: Floats, body=body, length=length) -> Floats:
            inertia = pinocchio.Inertia(
                body.mass_kg * (1.0 + off[0]), body.com_m + length * off[1:4], body.inertia_kg_m2 * (1.0 + off[4])
            )
            return inertia.toDynamicParameters()

        rows = slice(PER_BODY * link, PER_BODY * (link + 1))
        out[rows, 5 * link : 5 * link + 5] = trust * _differentiated(parameters, np.zeros(5))
    return out


def _differentiated(function: Callable[[Floats], Floats], at: Floats) -> Floats:
    columns = []
    for place in range(len(at)):
        step = np.zeros(len(at))
        step[place] = STEP * max(abs(at[place]), STEP)
        columns.append((function(at + step) - function(at - step)) / (2.0 * step[place]))
    return np.column_stack(columns)


def _own_sizes(arm: MovingArm) -> Mapping[str, Floats]:
    """Standard deviations (N,) of the first columns of every axis, by quantity."""
    friction, axes = arm.friction, len(arm.rated_nm)
    return {
        "coulomb_nm": FREE * friction.coulomb_nm,
        "viscous_nm_s_rad": FREE * arm.viscous_nm_s_rad,
        "rotor_inertia_kg_m2": FREE * arm.rotor_inertia_kg_m2,
        "load_friction": np.full(axes, FREE_LOSS),
        "delay_s": np.full(axes, FREE_DELAY_S),
    }


def _axis_columns(arm: MovingArm, runs: list[_Run], axis: int, motion: PeriodicMotion) -> Floats:
    """Columns of one axis over all runs, each per standard deviation of its prior."""
    parts = []
    for run in runs:
        qd, sign = run.qd[:, axis], np.sign(run.qd[:, axis])
        motor = (run.through * run.behind)[:, axis]
        cold = arm.friction.cold(run.time_s)[:, axis]
        share = np.abs(run.tau[:, axis]) / arm.rated_nm[axis]
        turn = arm.gear_ratio[axis] * run.q[:, axis]
        fades = np.exp(-((np.abs(qd) / arm.stribeck_rad_s[axis]) ** arm.stribeck_power[axis]))
        through = run.through[:, axis]
        own = [
            through * sign * cold,
            through * qd * cold,
            through * run.qdd[:, axis],
            through * sign * arm.rated_nm[axis] * share ** arm.friction.load_power[axis],
            -np.gradient(motor, 1.0 / motion.rate_hz),
        ]
        columns = [column * size[axis] for column, size in zip(own, _own_sizes(arm).values(), strict=True)]
        columns += [
            motor * max(arm.gain_std[axis], 1e-9),
            through * sign * fades * arm.friction.coulomb_nm[axis] * (FREE if arm.breakaway_share[axis] else 0.0),
            through * arm.friction.bias_std * arm.friction.coulomb_nm[axis],
            motor * np.where(run.drives[:, axis], -1.0, 1.0) * arm.friction.efficiency_std,
            -motor * arm.friction.split_std,
        ]
        waves = [np.sin(turn), np.cos(turn), np.sin(2.0 * turn), np.cos(2.0 * turn)]
        columns += [wave * arm.cogging_std_nm[axis] for wave in waves]
        parts.append(np.column_stack(columns))
    strokes = [_stroke_columns(arm, run, axis, motion.periods) for run in runs]
    blank = [np.zeros_like(stroke) for stroke in strokes]
    beside = [
        np.hstack([strokes[k] if k == number else blank[k][: len(strokes[number])] for k in range(len(runs))])
        for number in range(len(runs))
    ]
    return np.vstack([np.hstack(pair) for pair in zip(parts, beside, strict=True)])


def _stroke_columns(arm: MovingArm, run: _Run, axis: int, periods: int) -> Floats:
    """Friction error of every stroke, as the mean over the periods."""
    sign = np.sign(run.qd[:, axis])
    number = np.cumsum(np.diff(sign > 0, prepend=sign[:1] > 0) != 0)
    size = arm.friction.tail_share[axis] * arm.friction.coulomb_nm[axis] / np.sqrt(periods)
    return size * (run.through[:, axis] * sign)[:, None] * (number[:, None] == np.arange(number.max() + 1))


def _whitened(arm: MovingArm, axis: int, columns: Floats, motion: PeriodicMotion, runs: int) -> Floats:
    """Columns of all runs, each run divided by the root of the noise's spectrum."""
    count = len(columns) // runs
    density = _density(arm, axis, count, motion.rate_hz) / motion.periods
    parts = [np.fft.rfft(columns[run * count : (run + 1) * count], axis=0, norm="ortho") for run in range(runs)]
    twice = np.full(len(density), 2.0)
    twice[0] = 1.0
    if count % 2 == 0:
        twice[-1] = 1.0
    weight = np.sqrt(twice / density)[:, None]
    return np.vstack([part for run in parts for part in ((weight * run).real, (weight * run).imag)])


def _density(arm: MovingArm, axis: int, count: int, rate_hz: float) -> Floats:
    """Variance of the noise of one reading at the frequencies of one period, resolution included."""
    keep = np.exp(-1.0 / (rate_hz * arm.noise_s[axis]))
    turn = np.exp(-2j * np.pi * np.arange(count // 2 + 1) / count)
    coloured = (1.0 - keep**2) / np.abs(1.0 - keep * turn) ** 2
    share = arm.white_share
    return arm.noise_nm[axis] ** 2 * (share + (1.0 - share) * coloured) + arm.resolution_nm[axis] ** 2 / 12.0
