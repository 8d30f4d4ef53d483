"""The whole job of `servo-gateway cost`: cell, path and result in; cycle times and torque reserves out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.goto import HOME, destination
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.cost.timing import JointPath, PathTorque, TimedSegment, fastest_line, line_path, stretched, timed_path
from gateway.errors import DataUnusable, PlanRefused
from gateway.feedforward.identified import notes_of
from gateway.feedforward.load import FeedLoad, rated_load
from gateway.follow.path import FollowPath, check_path, read_path
from gateway.follow.settings import loaded_model
from gateway.identify.stated_effects import OF_PARTS, Stated, stated_terms
from gateway.model.visits import Gears
from gateway.motion.trajectory import MotionLimits, straight
from gateway.motion.workspace import Workspace, workspace_of
from gateway.result.result import LoadResult, Result

UNLOADED, RATED, ENTERED = "no load", "rated load", "entered load"
#: Turn of each joint to both sides: share of its range, and the most [rad].
RANGE_SHARE, MOST_RAD = 0.25, 0.5
#: Lengths that are tried.
SHORTER = (1.0, 0.5, 0.25, 0.125)


@dataclass(frozen=True, slots=True)
class SegmentCost:
    """A motion from rest to rest: duration [s], and the limit that keeps it from being faster."""

    duration_s: float
    limited_by: str


@dataclass(frozen=True, slots=True)
class SettingCost:
    """A path as planned with one statement of the load, driven with the identified load.

    Attributes
    ----------
    name : str
        "no load", "rated load", "entered load".
    mass_kg : float
        That the planner assumes.
    cycle_time_s : float
        Dwell times included.
    segments : tuple of SegmentCost
    torque_reserve : tuple of N floats
        1 less the largest motor torque over its limit; negative = the axis is overloaded. NaN, as the cycle time,
        where the torque limits do not suffice for the rated load.
    torque_reserve_std : tuple of N floats
        Standard deviation by the uncertainty of the load's mass and centre of gravity; NaN where unknown.
    load_acceleration_reserve : float
        The same for `load_acceleration_m_s2`; NaN where the cell states none.
    """

    name: str
    mass_kg: float
    cycle_time_s: float
    segments: tuple[SegmentCost, ...]
    torque_reserve: tuple[float, ...]
    torque_reserve_std: tuple[float, ...]
    load_acceleration_reserve: float


@dataclass(frozen=True, slots=True)
class MoveCost:
    """A path or a standard move under every setting."""

    name: str
    settings: tuple[SettingCost, ...]


@dataclass(frozen=True, slots=True)
class LoadCost:
    """What the entered load costs on one arm.

    Attributes
    ----------
    cell, arm : str
    load : str
        Label.
    mass_kg, mass_std_kg : float
    moves : tuple of MoveCost
    remarks : tuple of str
        What is not in the figures.
    """

    cell: str
    arm: str
    load: str
    mass_kg: float
    mass_std_kg: float
    moves: tuple[MoveCost, ...]
    remarks: tuple[str, ...] = ()
    schema: int = 1
    kind: str = "cost"


def cost_of(
    loaded: LoadedCell, arm: ArmConfig, load_file: Path, label: str | None = None, path_file: Path | None = None
) -> LoadCost:
    """Cycle time and torque reserve of a path, or of the standard moves, before and after the load is entered.

    Raises
    ------
    ConfigError
        Links that are not known, or a label that the result does not have.
    InputError
        A file that cannot be used, or a load of another robot, cell, arm or frame.
    DataUnusable
        No identified load.
    PlanRefused
        The path leaves the workspace, or the torque does not suffice to move the load along it.
    """
    result, load, model = loaded_model(loaded, arm, load_file, label, fed=False)
    workspace, period_s = workspace_of(arm, model.robot), loaded.cell.bus[arm.bus].sync_period_s
    if path_file is not None:
        paths, refused = [read_path(path_file, workspace, period_s)], []
        check_path(paths[0], workspace)
    else:
        home = destination(arm, workspace, HOME)
        paths, refused = standard_moves(workspace, np.array(home.q_rad), period_s)
    variants = _variants(load, next(each for each in result.loads if each.label == load.label))
    stated, left_out = _effects(result, len(arm.axis))
    planned: dict[str, FeedLoad | None] = {UNLOADED: None}
    if arm.rated_load_kg is not None or arm.max_load_kg is not None:
        planned[RATED] = rated_load(arm, model.robot)
    planned[ENTERED] = load

    def torque(path: JointPath, carried: FeedLoad | None) -> PathTorque:
        return PathTorque(path, model, carried, arm.load_acceleration_m_s2, stated)

    mounted, is_limited = (load, *variants), arm.load_acceleration_m_s2 is not None
    moves = tuple(MoveCost(path.name, tuple(_settings(path, planned, mounted, torque, is_limited))) for path in paths)
    remarks = [f"standard move {name} is left out: the workspace has no room for it" for name in refused]
    remarks += [f"{joints}: {note}" for joints, note in notes_of([axis.notes for axis in model.sources])]
    remarks += [
        f"{joints}: {name} is not in the torque: it is neither identified nor given in the cell file"
        for joints, name in notes_of([axis.missing for axis in model.sources])
    ]
    assumed = [f"J{joint}" for joint, axis in enumerate(arm.axis, 1) if axis.torque_limit_is_assumed]
    if assumed:
        remarks.append(f"{', '.join(assumed)}: torque_limit_nm is assumed; confirm it before relying on the reserve")
    if not variants:
        remarks.append(f"load '{load.label}': its uncertainty is incomplete, so the reserve has no interval")
    if left_out:
        remarks.append(f"effects of the result that are not in the torque: {', '.join(left_out)}")
    remarks.append(f"inertia of the load: {load.inertia_source}")
    return LoadCost(
        cell=loaded.cell.name,
        arm=arm.name,
        load=load.label,
        mass_kg=load.mass_kg,
        mass_std_kg=load.mass_std_kg,
        moves=moves,
        remarks=tuple(remarks),
    )


def _effects(result: Result, axes: int) -> tuple[tuple[Stated, ...], tuple[str, ...]]:
    """Effects of parts that the arm has, and names of those that are not in the torque."""
    used: list[Stated] = []
    left_out: list[str] = []
    for effect in result.effects:
        try:
            if effect.name not in OF_PARTS or result.verdict == "undecided":
                raise DataUnusable(effect.name)
            used += stated_terms([effect], Gears.of(None, axes), axes)
        except DataUnusable:
            left_out.append(effect.name)
    return tuple(used), tuple(dict.fromkeys(left_out))


def _variants(load: FeedLoad, stated: LoadResult) -> tuple[FeedLoad, ...]:
    """The load, changed along each column of a square root of the covariance of mass and centre of gravity."""
    std = np.array([stated.mass_std_kg, *(stated.com_std_m or (np.nan,) * 3)])
    if not np.isfinite(std).all():
        return ()
    correlation = np.eye(4) if stated.correlation is None else np.array(stated.correlation, dtype=float)
    size, direction = np.linalg.eigh(np.outer(std, std) * correlation)
    columns = (direction * np.sqrt(np.maximum(size, 0.0))).T
    return tuple(replace(load, mass_kg=load.mass_kg + by[0], com_m=load.com_m + by[1:]) for by in columns)


def _settings(
    path: FollowPath,
    planned: Mapping[str, FeedLoad | None],
    mounted: Sequence[FeedLoad],
    torque: Callable[[JointPath, FeedLoad | None], PathTorque],
    load_is_limited: bool,
) -> Iterator[SettingCost]:
    """Costs of one path, planned with each load and driven with the mounted one, which is followed by its variants."""
    starts = [path.start_rad, *(motion.q_rad[-1] for motion in path.motions[:-1])]
    pieces = [
        timed_path(start, motion) if path.limits is None else line_path(start, motion.q_rad[-1])
        for start, motion in zip(starts, path.motions, strict=True)
    ]
    driven = [[torque(piece, load) for load in mounted] for piece in pieces]
    axes = np.arange(len(path.start_rad))
    for name, load in planned.items():
        mass_kg, segments = 0.0 if load is None else load.mass_kg, list[TimedSegment]()
        for number, piece in enumerate(pieces, start=1):
            assumed = torque(piece, load)
            if path.limits is None:
                segment = stretched(piece, assumed)
            else:
                segment = fastest_line(piece.q_rad[0], piece.q_rad[-1], path.limits, path.period_s, assumed)
            if segment is None and name != RATED:
                raise PlanRefused(
                    f"path '{path.name}', segment {number}: the torque limits do not suffice to move the arm with a "
                    f"load of {mass_kg:.4g} kg along it at any speed; change the path, or correct load and "
                    "torque_limit_nm"
                )
            if segment is None:
                segments.clear()
                break
            segments.append(segment)
        # shares of the limits with the mounted load; NaN where the path cannot be planned
        largest, std = np.full((2, len(axes)), 0.0 if segments else np.nan)
        acceleration = 0.0 if segments else np.nan
        for (entered, *variants), segment in zip(driven, segments, strict=bool(segments)):
            share = entered.torque_shares(segment.law)
            row = np.argmax(np.abs(share), axis=0), axes
            changed = [variant.torque_shares(segment.law)[row] for variant in variants]
            spread = np.sqrt(np.sum([(each - share[row]) ** 2 for each in changed], axis=0)) if changed else np.nan
            peak = np.abs(share[row])
            std, largest = np.where(peak > largest, spread, std), np.maximum(largest, peak)
            acceleration = max(acceleration, float(entered.load_shares(segment.law).max()))
        yield SettingCost(
            name=name,
            mass_kg=mass_kg,
            cycle_time_s=sum(segment.duration_s + path.dwell_s for segment in segments) or np.nan,
            segments=tuple(SegmentCost(segment.duration_s, segment.limited_by) for segment in segments),
            torque_reserve=tuple((1.0 - largest).tolist()),
            torque_reserve_std=tuple(std.tolist()),
            load_acceleration_reserve=1.0 - acceleration if load_is_limited else np.nan,
        )


Floats = NDArray[np.float64]


def standard_moves(workspace: Workspace, home_rad: Floats, period_s: float) -> tuple[list[FollowPath], list[str]]:
    """Return the standard moves that the workspace allows, and the names of those it refuses.

    Raises
    ------
    PlanRefused
        It refuses all of them.
    """
    limits = MotionLimits(workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
    margin = np.minimum(home_rad - workspace.lower_rad, workspace.upper_rad - home_rad)
    quarter = RANGE_SHARE * (workspace.upper_rad - workspace.lower_rad)
    # how far each joint turns to both sides [rad]
    most = np.minimum(np.minimum(quarter, MOST_RAD), np.maximum(margin, 0.0))
    turns = {f"J{joint}": most * line for joint, line in enumerate(np.eye(len(most)), start=1)} | {"all": most}
    moves, refused = [], []
    for name, turned in turns.items():
        allowed = (
            (home_rad - share * turned, home_rad + share * turned)
            for share in SHORTER
            if workspace.refused_on(np.array([home_rad - share * turned, home_rad + share * turned])) is None
        )
        ends = next(allowed, None)
        if ends is None:
            refused.append(name)
            continue
        low, high = ends
        motions = (straight(low, high, limits, period_s), straight(high, low, limits, period_s))
        moves.append(FollowPath(name, low, motions, 0.0, period_s, limits))
    if not moves:
        raise PlanRefused("no standard move about the home posture is free; give a path with --path FILE")
    return moves, refused
