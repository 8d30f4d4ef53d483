"""From a cell file to a checked plan of motions that an arm is learnt from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gateway.analyse.given import constants_std, profile_of
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import PlanRefused
from gateway.excite.design import INSTANTS, Members, fitted, random_members, rows_of, start_postures
from gateway.excite.excitation import Excitation, MovingPlan
from gateway.excite.expected import CORRELATION_S, LoadModel, TorqueNoise
from gateway.excite.family import Family
from gateway.excite.limits import HELD, PLANNED, MovingLimits, States, moving_limits
from gateway.excite.plan_file import read_moving_plan
from gateway.feedforward.load import FeedLoad, assumed_load
from gateway.model.arm_model import arm_named, arm_robot
from gateway.motion.assumed import NOISE_SOURCE, assumed_noise_nm, reference_load
from gateway.motion.places import angles
from gateway.motion.torque_need import links_with_loads
from gateway.motion.workspace import Workspace, workspace_of

__all__ = ["MovingRequest", "check_moving_plan", "make_moving_plan", "read_moving_plan"]

Floats = NDArray[np.float64]
Purpose = Literal["load", "friction", "rotor"]
Choice = Literal["optimised", "random"]

HARMONICS = 5
#: Periods of a series [s]: a shorter one leaves the joints no room to move, a longer one is gravity alone.
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 5.0, 20.0
#: What keeps limits at so many instants a period keeps them in between, but for a share of 1e-4.
CHECKED_S = 0.002
_CLOSE = 1e-6


@dataclass(frozen=True, slots=True)
class MovingRequest:
    """What is to be learnt, and how long it may take.

    Attributes
    ----------
    purpose : tuple of Purpose
    period_s : float
    periods : int
    seed : int
    choice : Choice
        `random`: the best of the random motions that the optimised one is compared to.
    load : FeedLoad or None
        What will hang there; None = what the cell says the arm may carry.
    noise : TorqueNoise or None
        As it was measured; None = as it is assumed before anything was.
    """

    purpose: tuple[Purpose, ...] = ("load",)
    period_s: float = 10.0
    periods: int = 3
    seed: int = 1
    choice: Choice = "optimised"
    load: FeedLoad | None = None
    noise: TorqueNoise | None = None


def make_moving_plan(loaded: LoadedCell, arm: str | None, request: MovingRequest) -> MovingPlan:
    """Plan of motions; needs no bus, the same for the same request.

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
    PlanRefused
        No room to move inside the limits, or a period or a number of periods that tell nothing.
    """
    _check_request(request)
    config = arm_named(loaded, arm)
    workspace = workspace_of(config, arm_robot(loaded, config))
    plan = _series_plan(loaded, config, workspace, request)
    check_moving_plan(plan, workspace, config)
    return plan


def _check_request(request: MovingRequest) -> None:
    if not SHORTEST_PERIOD_S <= request.period_s <= LONGEST_PERIOD_S:
        raise PlanRefused(
            f"a period of {request.period_s:g} s: use {SHORTEST_PERIOD_S:g} to {LONGEST_PERIOD_S:g} s; a shorter one "
            "leaves no room to move, a longer one tells of gravity alone"
        )
    if request.periods < 2:
        raise PlanRefused("one period tells noise and motion not apart: drive two at least, three are usual")


def noise_of(loaded: LoadedCell, config: ArmConfig, workspace: Workspace) -> TorqueNoise:
    """Noise that is assumed of an arm before any was measured, and how far its torque constants are trusted."""
    gain_std = np.maximum(constants_std(config, profile_of((), loaded)), 1e-9)
    return TorqueNoise(assumed_noise_nm(workspace), CORRELATION_S, NOISE_SOURCE, gain_std)


def _series_plan(loaded: LoadedCell, config: ArmConfig, workspace: Workspace, request: MovingRequest) -> MovingPlan:
    random = np.random.default_rng(request.seed)
    limits = moving_limits(config, workspace.roomy(), PLANNED, request.load)
    starts = start_postures(limits, _known_postures(config, workspace), random)
    load = request.load or assumed_load("reference", *reference_load(workspace, starts), "assumed")
    links = links_with_loads(workspace, config, ())
    model = LoadModel(
        workspace, request.noise or noise_of(loaded, config, workspace), load, None if links is None else links[:, 0]
    )
    family = Family.of(request.period_s, HARMONICS, INSTANTS)
    members = random_members(family, limits, starts, random)
    best = int(np.argmin(scores(model, limits, family, members, request.periods)))
    chosen = fitted(Family.of(request.period_s, HARMONICS, 500), limits, members.only(np.array([best])))
    series = family.series("load", chosen.start_rad[0], chosen.free[0], request.periods)
    return MovingPlan(config.name, (series,), {})


def scores(model: LoadModel, limits: MovingLimits, family: Family, members: Members, periods: int) -> Floats:
    """Mean logarithm (m,) of the standard deviations that each of several series promises."""
    states, rigid = rows_of(limits, family, members)
    covariance = model.covariance(states, rigid, len(members), periods * family.period_s)
    return 0.5 * np.log(np.diagonal(covariance, axis1=1, axis2=2)).mean(axis=1)


def _known_postures(config: ArmConfig, workspace: Workspace) -> list[Floats]:
    named = [config.home_rad, config.loading_rad, config.start_rad]
    return [(workspace.lower_rad + workspace.upper_rad) / 2, *(np.array(each) for each in named if each is not None)]


def check_moving_plan(plan: MovingPlan, workspace: Workspace, config: ArmConfig) -> None:
    """Refuse a plan that breaks a limit anywhere.

    Parameters
    ----------
    plan : MovingPlan
    workspace : Workspace
    config : ArmConfig
        Loads, rotors, friction, and what the load may be accelerated with.

    Raises
    ------
    PlanRefused
        Names excitation, limit and instant.
    """
    for excitation in plan.excitations:
        where = f"arm '{plan.arm}', motion '{excitation.name}'"
        start = np.asarray(excitation.start_rad)
        if start.shape != (workspace.robot.axes,):
            raise PlanRefused(f"{where}: is of {len(start)} axes, the arm has {workspace.robot.axes}")
        reason = workspace.why_not(start, workspace.rest_share)
        if reason is not None:
            raise PlanRefused(f"{where}: starts at {angles(start)}: {reason}")
        states = states_of(excitation, CHECKED_S)
        _check_shares(moving_limits(config, workspace, HELD), states, where)
        reason = workspace.why_not_path(np.vstack([start, states.q_rad]))
        if reason is not None:
            raise PlanRefused(f"{where}: {reason}")


def states_of(excitation: Excitation, step_s: float) -> States:
    """One period as it is driven, a row every `step_s`; jerk from the accelerations."""
    motion = excitation.motion(step_s)
    before = np.vstack([np.zeros_like(motion.qdd_rad_s2[:1]), motion.qdd_rad_s2[:-1]])
    return States(motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2, (motion.qdd_rad_s2 - before) / step_s)


def _check_shares(limits: MovingLimits, states: States, where: str) -> None:
    share = limits.shares(states)
    row, column = np.unravel_index(np.argmax(share), share.shape)
    if not share[row, column] <= 1.0 + _CLOSE:
        taken, there = share[row, column], angles(states.q_rad[row])
        raise PlanRefused(f"{where}: {limits.names[column]} takes {taken:.2f} of its limit at {there}")
