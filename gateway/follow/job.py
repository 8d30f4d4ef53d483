"""Job of `servo-gateway follow`: read and check the files, drive the path, compare."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import DataUnusable
from gateway.feedforward.identified import checked, read_identified
from gateway.feedforward.load import FeedLoad, check_origin, identified_load
from gateway.follow.path import FollowPath, check_path, read_path
from gateway.follow.path_run import Progress, follow
from gateway.follow.settings import FeedModel, Setting, check_offsets, feed_model, three_settings
from gateway.follow.track import Track
from gateway.follow.trend import Trend, load_trend
from gateway.model.arm_model import arm_robot
from gateway.model.load_bounds import load_bounds
from gateway.motion.opening import OpenArm, axis_setups
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import Workspace, workspace_of
from gateway.result.follow import IDENTIFIED
from gateway.result.result import Result, read_result


@dataclass(frozen=True, slots=True)
class FollowRequest:
    """Path to follow, and the load in the feedforward.

    Attributes
    ----------
    path : Path
        TOML or CSV, see `gateway.follow.path`.
    load : Path or None
        Result JSON of `estimate`, `diagnose` or `commission`.
    label : str or None
        Label of the load in the result.
    """

    path: Path
    load: Path | None
    label: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Job after all checks that need no bus.

    Attributes
    ----------
    loaded : LoadedCell
    arm : ArmConfig
    workspace : Workspace
    path : FollowPath
    path_file : str
    model : FeedModel
    settings : tuple of Setting
    """

    loaded: LoadedCell
    arm: ArmConfig
    workspace: Workspace
    path: FollowPath
    path_file: str
    model: FeedModel
    settings: tuple[Setting, ...]

    @property
    def duration_s(self) -> float:
        """Time of all passes of the path, without the transfer motions between them."""
        return len(self.settings) * self.path.duration_s


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Recorded passes; `tracks` correspond to the settings one by one."""

    prepared: Prepared
    tracks: tuple[Track, ...]
    trend: Trend | None


def prepare(loaded: LoadedCell, arm: ArmConfig, request: FollowRequest) -> Prepared:
    """Read and check path, load, cell and profiles; no bus is opened and nothing moves.

    Raises
    ------
    ConfigError
        A profile lacks the objects, a link is unknown, or there is no rated load.
    InputError
        A file cannot be used, a load is of another robot, cell, arm or frame, or constants contradict each other.
    DataUnusable
        The result holds no identified load.
    PlanRefused
        The path leaves the workspace, or an offset reaches its limit.
    """
    _, load, model = loaded_model(loaded, arm, request.load, request.label)
    settings = three_settings(arm, model, load)
    workspace = workspace_of(arm, model.robot)
    path = read_path(request.path, workspace, loaded.cell.bus[arm.bus].sync_period_s)
    check_path(path, workspace)
    check_offsets(path, settings, arm.name)
    return Prepared(loaded, arm, workspace, path, str(request.path), model, settings)


def loaded_model(
    loaded: LoadedCell, arm: ArmConfig, load_file: Path | None, label: str | None, *, fed: bool = True
) -> tuple[Result, FeedLoad, FeedModel]:
    """Result, its load, and the model of the arm; `fed` as in `feed_model`; raises as `prepare`."""
    if load_file is None:
        raise DataUnusable(
            "no identified load: give --load RESULT.json, as `servo-gateway estimate DATA --json RESULT.json` or "
            "`commission` writes it for this cell"
        )
    robot = arm_robot(loaded, arm)
    profiles = [setup.profile for setup in axis_setups(loaded, arm)]
    result, where = read_result(load_file), str(load_file)
    check_origin(result, loaded, arm, robot, where)
    load = identified_load(result, label, where, load_bounds(robot, arm))
    identified = read_identified(loaded, arm, robot)
    if identified is None and result.motion:
        identified = checked(result, where, robot.axes)
    return result, load, feed_model(arm, robot, profiles, result, identified, fed=fed)


def drive(opened: OpenArm, prepared: Prepared, progress: Progress, options: MoveOptions | None = None) -> Comparison:
    """Drive the path with every setting and compare.

    Raises
    ------
    PlanRefused, LimitExceeded, DriveError, KeyboardInterrupt
        As `gateway.follow.path_run.follow`.
    """
    tracks = follow(
        opened.arm,
        prepared.workspace,
        prepared.path,
        prepared.settings,
        progress,
        options,
        opened.group.timing.pacing,
    )
    trend = None
    for setting, track in zip(prepared.settings, tracks, strict=True):
        if setting.name == IDENTIFIED and setting.load is not None:
            trend = load_trend(track, prepared.model, setting.load)
    return Comparison(prepared, tracks, trend)
