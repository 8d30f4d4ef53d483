"""Build the robot model of an arm from the description that the cell file names."""

from __future__ import annotations

from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import ConfigError
from gateway.model.load_bounds import refuse_stated_loads
from gateway.model.robot import Robot, or_another_tip, robot_from_dh, robot_from_urdf, with_flange
from gateway.model.urdf_text import read_urdf


def arm_named(loaded: LoadedCell, name: str | None = None) -> ArmConfig:
    """Return the arm with a name, or the only arm of the cell.

    Raises
    ------
    ConfigError
        There is no such arm, or several arms and no name.
    """
    arms = loaded.cell.arm
    if name is None and len(arms) == 1:
        return arms[0]
    for arm in arms:
        if arm.name == name:
            return arm
    known = ", ".join(arm.name for arm in arms)
    asked = "no arm was named" if name is None else f"there is no arm '{name}'"
    raise ConfigError(f"cell '{loaded.cell.name}': {asked}; it has {known}: name one by --arm")


def robot_text(loaded: LoadedCell, arm: ArmConfig) -> str:
    """Return the URDF text of the arm; empty for an arm defined by Denavit-Hartenberg parameters.

    Raises
    ------
    ConfigError
        The file cannot be read.
    """
    if arm.robot is None:
        return ""
    try:
        return read_urdf(loaded.path(arm.robot))
    except ConfigError as error:
        error.add_note(f"or correct the key robot of arm '{arm.name}'")
        raise


def robot_place(loaded: LoadedCell, arm: ArmConfig) -> str:
    """Return the path of the arm's URDF, for messages and for mesh files; "cell" without a URDF."""
    return "cell" if arm.robot is None else str(loaded.path(arm.robot))


def arm_robot(loaded: LoadedCell, arm: ArmConfig) -> Robot:
    """Return the robot model of an arm, with the flange of the cell file if it defines one.

    Raises
    ------
    ConfigError
        File unreadable, or not a chain of one to eight revolute joints.
    """
    return robot_from_text(arm, robot_text(loaded, arm), robot_place(loaded, arm))


def robot_from_text(arm: ArmConfig, text: str, where: str) -> Robot:
    """Return the robot model of an arm from URDF text that was already read (or stored in a recording).

    Raises
    ------
    ConfigError
        Not a chain of one to eight revolute joints, or the number of joints differs from that of the axes.
    """
    robot = robot_from_dh(arm.dh, arm.name) if arm.dh is not None else robot_from_urdf(text, where, arm.tip)
    if robot.axes != len(arm.axis):
        raise ConfigError(
            f"{where}: robot '{robot.name}' has {robot.axes} axes, arm '{arm.name}' {len(arm.axis)} [[arm.axis]]"
            f" tables; give one table per axis{or_another_tip(robot, len(arm.axis))}"
        )
    refuse_stated_loads(arm, robot, where)
    if arm.flange_xyz_m is None:
        return robot
    return with_flange(robot, arm.flange_xyz_m, arm.flange_rpy_rad)
