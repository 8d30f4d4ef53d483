"""Prepare `servo-gateway follow`: read and check the files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import DataUnusable
from gateway.feedforward.identified import checked, read_identified
from gateway.feedforward.load import FeedLoad, check_origin, identified_load
from gateway.follow.path import FollowPath, check_path, read_path
from gateway.follow.settings import FeedModel, Setting, check_offsets, feed_model, three_settings
from gateway.model.arm_model import arm_robot
from gateway.model.load_bounds import load_bounds
from gateway.motion.opening import axis_setups
from gateway.motion.workspace import Workspace, workspace_of
from gateway.result.result import Result, read_result


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


def prepare(
    loaded: LoadedCell, arm: ArmConfig, path_file: Path, load_file: Path | None, label: str | None = None
) -> Prepared:
    """Read and check path, load, cell and profiles; no bus is opened and nothing moves.

    Parameters
    ----------
    loaded : LoadedCell
    arm : ArmConfig
    path_file : Path
        TOML or CSV, see `gateway.follow.path`.
    load_file : Path or None
        Result JSON of `estimate`, `diagnose` or `commission`.
    label : str, optional
        Label of the load in the result.

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
    _, load, model = loaded_model(loaded, arm, load_file, label)
    settings = three_settings(arm, model, load)
    workspace = workspace_of(arm, model.robot)
    path = read_path(path_file, workspace, loaded.cell.bus[arm.bus].sync_period_s)
    check_path(path, workspace)
    check_offsets(path, settings, arm.name)
    return Prepared(loaded, arm, workspace, path, str(path_file), model, settings)


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
