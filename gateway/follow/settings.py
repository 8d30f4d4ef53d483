"""Prepare `servo-gateway follow`: read and check the files, and make the three settings of the comparison.

The settings are no feedforward, feedforward with the maximum load, and with the identified load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import PlanRefused
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.identified import Identified, checked, corrected_parameters, drawn_parameters, read_identified
from gateway.feedforward.law import AxisTerms, FeedforwardLaw, axis_terms
from gateway.feedforward.load import FeedLoad, check_origin, identified_load, rated_load
from gateway.follow.path import FollowPath, check_path, read_path
from gateway.model.arm_model import arm_robot
from gateway.model.load_bounds import load_bounds
from gateway.model.robot import Robot
from gateway.motion.opening import axis_setups
from gateway.motion.workspace import Workspace, workspace_of
from gateway.result.follow import IDENTIFIED, MAXIMUM, OFF, AxisSources
from gateway.result.result import Result, read_result

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """Setting of the feedforward; `law` and `load` are None without feedforward."""

    name: str
    law: FeedforwardLaw | None
    load: FeedLoad | None


@dataclass(frozen=True, slots=True, eq=False)
class FeedModel:
    """Model of arm and axes in the feedforward.

    Attributes
    ----------
    robot : Robot
    gravity_m_s2 : array of shape (3,)
    links : array of shape (60,)
        Inertial parameters of the unloaded arm.
    links_source : str
    axes : tuple of 6 AxisTerms
    sources : tuple of 6 AxisSources
    coupling : array of shape (6, 6)
    """

    robot: Robot
    gravity_m_s2: Floats
    links: Floats
    links_source: str
    axes: tuple[AxisTerms, ...]
    sources: tuple[AxisSources, ...]
    coupling: Floats

    def law(self, load: FeedLoad) -> FeedforwardLaw:
        """Return the feedforward law of the arm with a load."""
        parameters = self.links.copy()
        parameters[50:] += load.parameters
        return FeedforwardLaw(ArmDynamics(self.robot, parameters, self.gravity_m_s2), self.axes, self.coupling)

    def terms(self, name: str) -> Floats:
        """Return one of the terms of `AxisTerms` of every axis (N,)."""
        return np.array([getattr(axis, name) for axis in self.axes])

    def friction_nm(self, carried_nm: Floats, rate_rad_s: Floats, side: Floats) -> Floats:
        """Return the friction (n, N) [Nm] at the gear outputs, as `FeedforwardLaw` computes it for one instant.

        Parameters
        ----------
        carried_nm, rate_rad_s : arrays of shape (n, N)
            Torque at the gear outputs without friction, and their angular speeds.
        side : array of shape (n, N)
            Direction of friction by sign.
        """
        onset = self.terms("onset_nm") * np.exp(-((rate_rad_s / self.terms("stribeck_rad_s")) ** 2))
        dry = self.terms("coulomb_nm") + onset + self.terms("load_friction") * np.abs(carried_nm)
        return dry * side + self.terms("viscous_nm_s_rad") * rate_rad_s


def feed_model(
    arm: ArmConfig,
    robot: Robot,
    profiles: Sequence[DriveProfile],
    result: Result,
    identified: Identified | None = None,
    *,
    fed: bool = True,
) -> FeedModel:
    """Return the model of an arm: robot model, corrected by the result's identification of the unloaded arm.

    `fed` is False if the offsets are only computed: the drives then need no objects for them.

    Raises
    ------
    ConfigError
        A link is unknown, or a profile lacks the objects.
    InputError
        An identified value contradicts the stated one.
    """
    gravity = np.array(arm.gravity_m_s2)
    drawn = drawn_parameters(robot, arm)
    # with effects, the links are those of a model that has them
    alone = result.bare is None or bool(result.effects)
    links = None if result.bare is None or alone else corrected_parameters(robot, result.bare, gravity)
    source = "robot model" if links is None else "robot model, corrected by the identification of the unloaded arm"
    axes, sources = axis_terms(arm, profiles, result, identified, fed=fed)
    return FeedModel(
        robot=robot,
        gravity_m_s2=gravity,
        links=drawn if links is None else links,
        links_source=source,
        axes=axes,
        sources=sources,
        coupling=np.eye(6) if arm.coupling is None else np.array(arm.coupling, dtype=float),
    )


def three_settings(arm: ArmConfig, model: FeedModel, identified: FeedLoad) -> tuple[Setting, ...]:
    """Return the settings: off, maximum load, identified load.

    Raises
    ------
    ConfigError
        The cell file states no maximum load.
    """
    most = rated_load(arm, model.robot)
    return (
        Setting(OFF, None, None),
        Setting(MAXIMUM, model.law(most), most),
        Setting(IDENTIFIED, model.law(identified), identified),
    )


def check_offsets(path: FollowPath, settings: Sequence[Setting], arm: str) -> None:
    """Refuse a path that takes a torque offset to its limit with any setting, before anything moves.

    Raises
    ------
    PlanRefused
        Setting, axis, time, offset and limit are named.
    """
    for setting in settings:
        law, begun_s, sense, at = setting.law, 0.0, [0.0] * 6, path.start_rad
        if law is None:
            continue
        for motion in path.motions:
            steps = np.diff(np.vstack([at, motion.q_rad]), axis=0)
            at = motion.q_rad[-1]
            parts = (motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2, steps)
            for row, (q, velocity, acceleration, step) in enumerate(
                zip(*(part.tolist() for part in parts), strict=True), start=1
            ):
                sense = law.sense(sense, step)
                _, torque = law.offsets(q, velocity, acceleration, sense)
                excess = law.excess(torque)
                if excess is not None:
                    axis, value = excess
                    raise PlanRefused(
                        f"arm '{arm}', axis {axis + 1}, setting '{setting.name}', "
                        f"{begun_s + row * path.period_s:.2f} s into path '{path.name}': the feedforward requires"
                        f" {value:.2f} Nm at the motor, the limit is {law.limits_nm[axis]:.2f} Nm; not moved:"
                        " slow the path down, or correct load and torque_limit_nm"
                    )
            begun_s += motion.duration_s + path.dwell_s


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


def prepare(loaded: LoadedCell, arm: ArmConfig, path_file: Path, load_file: Path, label: str | None = None) -> Prepared:
    """Read and check path, load, cell and profiles; no bus is opened and nothing moves.

    Parameters
    ----------
    loaded : LoadedCell
    arm : ArmConfig
    path_file : Path
        TOML or CSV, see `gateway.follow.path`.
    load_file : Path
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
    loaded: LoadedCell, arm: ArmConfig, load_file: Path, label: str | None, *, fed: bool = True
) -> tuple[Result, FeedLoad, FeedModel]:
    """Result, its load, and the model of the arm; `fed` as in `feed_model`; raises as `prepare`."""
    robot = arm_robot(loaded, arm)
    profiles = [setup.profile for setup in axis_setups(loaded, arm)]
    result, where = read_result(load_file), str(load_file)
    check_origin(result, loaded, arm, robot, where)
    load = identified_load(result, label, where, load_bounds(robot, arm))
    identified = read_identified(loaded, arm, robot)
    if identified is None and result.motion:
        identified = checked(result, where, robot.axes)
    return result, load, feed_model(arm, robot, profiles, result, identified, fed=fed)
