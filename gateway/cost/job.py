"""The whole job of `servo-gateway cost`: cell, path and result in; cycle times and torque reserves out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.goto import HOME, destination
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.cost.moves import standard_moves
from gateway.cost.timing import TimedSegment, fastest_line, line_path, stretched, timed_path
from gateway.cost.torque import JointPath, PathTorque
from gateway.errors import DataUnusable, PlanRefused
from gateway.feedforward.identified import notes_of
from gateway.feedforward.load import FeedLoad, rated_load
from gateway.follow.job import loaded_model
from gateway.follow.path import FollowPath, check_path, read_path
from gateway.follow.settings import FeedModel
from gateway.identify.stated_effects import OF_PARTS, Stated, stated_terms
from gateway.model.visits import Gears
from gateway.motion.workspace import Workspace, workspace_of
from gateway.result.result import LoadResult, Result

Floats = NDArray[np.float64]
UNLOADED, RATED, ENTERED = "no load", "rated load", "entered load"


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


@dataclass(frozen=True, slots=True, eq=False)
class _Mounted:
    """Torque along a path with the load that is mounted, and with each of its variants; no plan changes it."""

    load: PathTorque
    variants: tuple[PathTorque, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Station:
    """The arm, its model, the mounted load and its variants by one standard deviation of each parameter."""

    arm: ArmConfig
    model: FeedModel
    load: FeedLoad
    variants: tuple[FeedLoad, ...]
    stated: tuple[Stated, ...]
    left_out: tuple[str, ...]

    def torque(self, path: JointPath, load: FeedLoad | None) -> PathTorque:
        return PathTorque(path, self.model, load, self.arm.load_acceleration_m_s2, self.stated)

    def mounted(self, path: JointPath) -> _Mounted:
        return _Mounted(self.torque(path, self.load), tuple(self.torque(path, each) for each in self.variants))


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
    period_s = loaded.cell.bus[arm.bus].sync_period_s
    paths, left_out = _paths(workspace_of(arm, model.robot), arm, path_file, period_s)
    stated = next(each for each in result.loads if each.label == load.label)
    station = _Station(arm, model, load, _variants(load, stated), *_effects(result, len(arm.axis)))
    return LoadCost(
        cell=loaded.cell.name,
        arm=arm.name,
        load=load.label,
        mass_kg=load.mass_kg,
        mass_std_kg=load.mass_std_kg,
        moves=tuple(MoveCost(path.name, tuple(_settings(station, path))) for path in paths),
        remarks=(*left_out, *_remarks(station)),
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


def _paths(
    workspace: Workspace, arm: ArmConfig, path_file: Path | None, period_s: float
) -> tuple[list[FollowPath], list[str]]:
    if path_file is not None:
        path = read_path(path_file, workspace, period_s)
        check_path(path, workspace)
        return [path], []
    home = destination(arm, workspace, HOME)
    moves, refused = standard_moves(workspace, np.array(home.q_rad), period_s)
    return moves, [f"standard move {name} is left out: the workspace has no room for it" for name in refused]


def _variants(load: FeedLoad, stated: LoadResult) -> tuple[FeedLoad, ...]:
    """The load, changed along each column of a square root of the covariance of mass and centre of gravity."""
    std = np.array([stated.mass_std_kg, *(stated.com_std_m or (np.nan,) * 3)])
    if not np.isfinite(std).all():
        return ()
    correlation = np.eye(4) if stated.correlation is None else np.array(stated.correlation, dtype=float)
    size, direction = np.linalg.eigh(np.outer(std, std) * correlation)
    columns = (direction * np.sqrt(np.maximum(size, 0.0))).T
    return tuple(replace(load, mass_kg=load.mass_kg + by[0], com_m=load.com_m + by[1:]) for by in columns)


def _settings(station: _Station, path: FollowPath) -> Iterator[SettingCost]:
    """Costs of one path with no load, the rated load and the identified load entered."""
    arm = station.arm
    planned: list[tuple[str, FeedLoad | None]] = [(UNLOADED, None)]
    if arm.rated_load_kg is not None or arm.max_load_kg is not None:
        planned.append((RATED, rated_load(arm, station.model.robot)))
    pieces = _pieces(path)
    mounted = [station.mounted(piece) for piece in pieces]
    for name, load in [*planned, (ENTERED, station.load)]:
        timed = [_timed(station, path, piece, load) for piece in pieces]
        missing = [number for number, segment in enumerate(timed, start=1) if segment is None]
        if missing and name != RATED:
            kg = 0.0 if load is None else load.mass_kg
            raise PlanRefused(
                f"path '{path.name}', segment {missing[0]}: the torque limits do not suffice to move the arm with a "
                f"load of {kg:.4g} kg along it at any speed; change the path, or correct load and torque_limit_nm"
            )
        segments = [] if missing else [each for each in timed if each is not None]
        largest, std, gripper = _used(mounted, segments, len(arm.axis))
        yield SettingCost(
            name=name,
            mass_kg=0.0 if load is None else load.mass_kg,
            cycle_time_s=sum(segment.duration_s + path.dwell_s for segment in segments) or np.nan,
            segments=tuple(SegmentCost(segment.duration_s, segment.limited_by) for segment in segments),
            torque_reserve=tuple((1.0 - largest).tolist()),
            torque_reserve_std=tuple(std.tolist()),
            load_acceleration_reserve=np.nan if arm.load_acceleration_m_s2 is None else 1.0 - gripper,
        )


def _pieces(path: FollowPath) -> list[JointPath]:
    """Geometry of the motions of a path, one after the other."""
    starts = [path.start_rad, *(motion.q_rad[-1] for motion in path.motions[:-1])]
    if path.limits is None:
        return [timed_path(start, motion) for start, motion in zip(starts, path.motions, strict=True)]
    return [line_path(start, motion.q_rad[-1]) for start, motion in zip(starts, path.motions, strict=True)]


def _timed(station: _Station, path: FollowPath, piece: JointPath, load: FeedLoad | None) -> TimedSegment | None:
    assumed = station.torque(piece, load)
    if path.limits is None:
        return stretched(piece, assumed)
    return fastest_line(piece.q_rad[0], piece.q_rad[-1], path.limits, path.period_s, assumed)


def _used(mounted: list[_Mounted], segments: list[TimedSegment], axes: int) -> tuple[Floats, Floats, float]:
    """Largest shares (axes,) of the torque limits with the mounted load, their standard deviations, and the load's
    largest share of its acceleration limit; NaN where the path cannot be planned.
    """
    largest, std = np.full((2, axes), 0.0 if segments else np.nan)
    gripper = 0.0 if segments else np.nan
    for torque, segment in zip(mounted, segments, strict=bool(segments)):
        share = torque.load.torque_shares(segment.law)
        row = np.argmax(np.abs(share), axis=0), np.arange(axes)
        changed = [variant.torque_shares(segment.law)[row] for variant in torque.variants]
        spread = np.sqrt(np.sum([(each - share[row]) ** 2 for each in changed], axis=0)) if changed else np.nan
        peak = np.abs(share[row])
        std, largest = np.where(peak > largest, spread, std), np.maximum(largest, peak)
        gripper = max(gripper, float(torque.load.load_shares(segment.law).max()))
    return largest, std, gripper


def _remarks(station: _Station) -> Iterator[str]:
    """What the figures do not contain, and limits that are not confirmed."""
    sources = station.model.sources
    for joints, note in notes_of([axis.notes for axis in sources]):
        yield f"{joints}: {note}"
    for joints, name in notes_of([axis.missing for axis in sources]):
        yield f"{joints}: {name} is not in the torque: it is neither identified nor given in the cell file"
    assumed = [f"J{joint}" for joint, axis in enumerate(station.arm.axis, 1) if axis.torque_limit_is_assumed]
    if assumed:
        yield f"{', '.join(assumed)}: torque_limit_nm is assumed; confirm it before relying on the reserve"
    if not station.variants:
        yield f"load '{station.load.label}': its uncertainty is incomplete, so the reserve has no interval"
    if station.left_out:
        yield f"effects of the result that are not in the torque: {', '.join(station.left_out)}"
    yield f"inertia of the load: {station.load.inertia_source}"
