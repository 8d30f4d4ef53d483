"""Make a checked plan of excitation trajectories from a cell file, with its summary for the operator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import PlanRefused
from gateway.excite.excitation import Excitation, MovingPlan
from gateway.excite.expected import (
    CORRELATION_S,
    AskedNumbers,
    DriveTrainAsked,
    LoadAsked,
    Purpose,
    TorqueNoise,
    arm_rows,
    stds_of_all,
)
from gateway.excite.limits import KINDS, LOAD_ACCELERATION, PLANNED, MovingLimits, moving_limits, states_of
from gateway.excite.random_series import start_postures
from gateway.excite.series_choice import chosen_series
from gateway.excite.sweep_choice import chosen_sweeps
from gateway.feedforward.identified import AxisConstants, axis_constants, read_identified
from gateway.feedforward.load import FeedLoad, assumed_load
from gateway.model.arm_model import arm_named, arm_robot
from gateway.motion.assumed import NOISE_SOURCE, assumed_noise_nm, reference_load
from gateway.motion.drive_limits import links_with_loads
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace, workspace_of
from gateway.pipeline.inputs import constants_std, profile_of
from gateway.preflight.rules import refuse_beyond_counts
from gateway.result.inertia import moments_of
from gateway.result.values import plain_values

Floats = NDArray[np.float64]

Choice = Literal["optimised", "random"]
FrictionBy = Literal["sweeps", "series"]

PURPOSES: tuple[Purpose, ...] = ("load", "friction", "rotor")
#: Periods of a series [s]: a shorter one leaves little travel, a longer one shows gravity only.
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 5.0, 20.0
#: One period does not separate motion from noise; a larger number is a typing error.
FEWEST_PERIODS, MOST_PERIODS = 2, 100
#: Periods of a sweep, which passes every angle at every speed in both directions.
SWEEP_PERIODS = 2
#: Instants of a period at which limits are checked: between them a limit is exceeded by 1e-4 at most.
CHECKED = 5000
#: Collision is checked along straight lines between every n-th of these instants, within 1e-4 rad of the path.
PROVEN = 5
_CLOSE = 1e-6
#: Sampling period of a motion [s].
STEP_S = 0.02


@dataclass(frozen=True, slots=True)
class MovingRequest:
    """Quantities to identify, and settings of the excitation trajectories.

    Attributes
    ----------
    purpose : tuple of Purpose
    period_s : float
        Period of a series.
    periods : int
        Periods of a series; a sweep is driven `SWEEP_PERIODS` times.
    seed : int
    choice : Choice
        `random`: the best random series, to which the optimised one is compared.
    friction_by : FrictionBy
        Sweeps of every joint, or the series of all joints.
    load : FeedLoad or None
        Load to be mounted; None = the largest load of the cell file.
    noise : TorqueNoise or None
        Measured noise; None = the assumed one.
    """

    purpose: tuple[Purpose, ...] = ("load",)
    period_s: float = 10.0
    periods: int = 3
    seed: int = 1
    choice: Choice = "optimised"
    friction_by: FrictionBy = "sweeps"
    load: FeedLoad | None = None
    noise: TorqueNoise | None = None


def make_moving_plan(loaded: LoadedCell, arm: str | None, request: MovingRequest) -> MovingPlan:
    """Return a plan of excitation trajectories; needs no bus, and is reproducible for the same request.

    Parameters
    ----------
    loaded : LoadedCell
    arm : str or None
        Name of the arm, if the cell has several.
    request : MovingRequest

    Raises
    ------
    ConfigError
        Cell or robot cannot be used.
    InputError
        The identification that the cell file names cannot be used.
    PlanRefused
        No free motion inside the limits, or a period or a number of periods out of range.
    """
    if not request.purpose or not set(request.purpose) <= set(PURPOSES):
        raise PlanRefused(f"no quantity to identify: name at least one of {', '.join(PURPOSES)}")
    if not SHORTEST_PERIOD_S <= request.period_s <= LONGEST_PERIOD_S:
        raise PlanRefused(
            f"a period of {request.period_s:g} s: use {SHORTEST_PERIOD_S:g} to {LONGEST_PERIOD_S:g} s; a shorter"
            " period allows too little travel, in a longer one gravity dominates"
        )
    if not FEWEST_PERIODS <= request.periods <= MOST_PERIODS:
        raise PlanRefused(
            f"{request.periods} periods: use {FEWEST_PERIODS} to {MOST_PERIODS}, three are usual; a single period"
            " does not separate motion from noise"
        )
    config = arm_named(loaded, arm)
    refuse_beyond_counts(loaded, config)
    robot = arm_robot(loaded, config)
    workspace = workspace_of(config, robot)
    known = axis_constants(config, read_identified(loaded, config, robot))
    limits = moving_limits(config, workspace.with_clearance(), known, PLANNED, request.load)
    random = np.random.default_rng(request.seed)
    anchors = _anchors(config, limits.workspace)
    starts = start_postures(limits, anchors, random)
    noise = request.noise or _noise(loaded, config, workspace)
    load = request.load or assumed_load(
        "reference", *reference_load(workspace, starts), "half of the load that the arm can carry"
    )
    # The requested quantities, each purpose once, in the order of `PURPOSES`
    carried = links_with_loads(workspace, config, ())
    links = None if carried is None else carried[:, 0]
    asked: dict[Purpose, AskedNumbers] = {}
    if "load" in request.purpose:
        asked["load"] = LoadAsked(workspace, noise, load, links)
    if "friction" in request.purpose:
        asked["friction"] = DriveTrainAsked.of(workspace, noise, "friction", links, config.link_std)
    if "rotor" in request.purpose:
        asked["rotor"] = DriveTrainAsked.of(workspace, noise, "rotor", links, config.link_std)
    excitations: list[Excitation] = []
    by_series = tuple(each for name, each in asked.items() if name != "friction" or request.friction_by == "series")
    over_random = None
    if by_series:
        period_s, periods = request.period_s, request.periods
        optimise = request.choice == "optimised"
        family, member, over_random = chosen_series(
            limits, anchors, by_series, period_s, periods, starts, random, optimise=optimise
        )
        name = " ".join(name for name, each in asked.items() if each in by_series)
        excitations.append(family.series(name, member.start_rad[0], member.free[0], periods))
    if len(by_series) < len(asked):
        excitations += chosen_sweeps(limits, [*anchors, *starts], min(request.periods, SWEEP_PERIODS))
    expected = plan_summary(excitations, asked, limits, load, over_random)
    plan = MovingPlan(config.name, tuple(excitations), expected)
    check_moving_plan(plan, workspace, config, known)
    return plan


def _noise(loaded: LoadedCell, config: ArmConfig, workspace: Workspace) -> TorqueNoise:
    """Return the assumed torque noise of an arm, and the standard deviations of its torque constants."""
    gain_std = np.maximum(constants_std(config, profile_of((), loaded)), 1e-9)
    return TorqueNoise(assumed_noise_nm(workspace), CORRELATION_S, NOISE_SOURCE, gain_std)


def _anchors(config: ArmConfig, workspace: Workspace) -> Floats:
    """Return the postures (k, N) named in the cell file where the arm may rest, and the middle of its ranges."""
    named = [config.home_rad, config.loading_rad, config.start_rad]
    middle = (workspace.lower_rad + workspace.upper_rad) / 2
    known = np.array([*(each for each in named if each is not None), middle])
    return known[workspace.feasible(known)]


def check_moving_plan(
    plan: MovingPlan, workspace: Workspace, config: ArmConfig, known: Sequence[AxisConstants] = ()
) -> None:
    """Refuse a plan that violates a limit.

    Parameters
    ----------
    plan : MovingPlan
    workspace : Workspace
    config : ArmConfig
        Loads and their largest acceleration; rotors and friction that were not identified.
    known : sequence of AxisConstants, one per axis, optional
        Rotors and friction; defaults to those of the cell file.

    Raises
    ------
    PlanRefused
        A limit is violated; the message names motion, limit and posture.
    """
    limits = moving_limits(config, workspace, known or axis_constants(config, None))
    for excitation in plan.excitations:
        where = f"arm '{plan.arm}', motion '{excitation.name}'"
        start = np.asarray(excitation.start_rad)
        if start.shape != (workspace.robot.axes,):
            raise PlanRefused(f"{where}: has {len(start)} axes, but the arm has {workspace.robot.axes}")
        reason = workspace.why_not(start, workspace.rest_share)
        if reason is not None:
            raise PlanRefused(f"{where}: starts at {angles(start)}: {reason}")
        states = states_of(excitation, excitation.period_s / CHECKED)
        share = limits.shares(states)
        row, column = np.unravel_index(np.argmax(share), share.shape)
        if not share[row, column] <= 1.0 + _CLOSE:
            taken, there = share[row, column], angles(states.q_rad[row])
            raise PlanRefused(f"{where}: {limits.names[column]} reaches {taken:.2f} of its limit at {there}")
        reason = workspace.why_not_path(np.vstack([start, states.q_rad[::PROVEN], start]))
        if reason is not None:
            raise PlanRefused(f"{where}: {reason}")


def plan_summary(
    excitations: Sequence[Excitation],
    asked: Mapping[Purpose, AskedNumbers],
    limits: MovingLimits,
    load: FeedLoad,
    over_random: float | None,
) -> dict[str, Any]:
    """Return the expected standard deviations of all motions together, and the share of the limits of each.

    Parameters
    ----------
    excitations : sequence of Excitation
    asked : mapping of Purpose to AskedNumbers
    limits : MovingLimits
        Limits of the planning; shares are of these.
    load : FeedLoad
        Load for which the standard deviations are expected.
    over_random : float or None
        Expected standard deviations of the series over those of the best random one.
    """
    rows: dict[Purpose, list[Floats]] = {name: [] for name in asked}
    taken: list[dict[str, Any]] = []
    for excitation in excitations:
        states = states_of(excitation, STEP_S)
        rigid = arm_rows(limits.workspace, states)
        duration_s = excitation.periods * excitation.period_s
        for name, each in asked.items():
            rows[name].append(each.rows(states, rigid, 1, duration_s))
        taken.append(
            {"name": excitation.name, "duration_s": duration_s, "share": _shares(limits, limits.shares(states, rigid))}
        )
    noise = next(iter(asked.values())).noise
    return plain_values(
        {
            "duration_s": sum(each["duration_s"] for each in taken),
            **{name: _stds(name, each, np.concatenate(rows[name]), load) for name, each in asked.items()},
            "over_random": over_random,
            "limits": taken,
            "not_checked": list(limits.unchecked),
            "noise_nm": noise.std_nm,
            "noise_source": noise.source,
            "correlation_s": noise.correlation_s,
            "gain_std": noise.gain_std,
        }
    )


def _shares(limits: MovingLimits, share: Floats) -> dict[str, Any]:
    """Return the largest share of each kind of limit per axis; of the load where the cell limits it."""
    peak = share.max(axis=0)
    axes = limits.workspace.robot.axes
    found: dict[str, Any] = {kind: peak[k * axes : (k + 1) * axes] for k, kind in enumerate(KINDS)}
    if limits.bodies is None:
        del found["torque"]
    if np.isfinite(limits.load_acceleration_m_s2):
        found[LOAD_ACCELERATION.replace(" ", "_")] = peak[-1]
    return found


def _stds(name: Purpose, asked: AskedNumbers, rows: Floats, load: FeedLoad) -> dict[str, Any]:
    """Return the standard deviations of one purpose under the names of a result."""
    std = stds_of_all(asked, rows)
    if isinstance(asked, LoadAsked):
        about: dict[str, Any] = {"mass_kg": load.mass_kg, "com_m": load.com_m, "source": load.source}
        about["inertia_kg_m2"] = moments_of(load.inertia_kg_m2)
        about["inertia_source"] = load.inertia_source
        return {"mass_std_kg": std[0], "com_std_m": std[1:4], "inertia_std_kg_m2": std[4:], "reference": about}
    if name == "rotor":
        return {"rotor_inertia_std_kg_m2": std}
    half = len(std) // 2
    return {"coulomb_std_nm": std[:half], "viscous_std_nm_s_rad": std[half:]}
