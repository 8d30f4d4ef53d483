"""Do the holding brakes hold? One axis at a time loses its power while the others hold theirs, and is watched."""

from __future__ import annotations

from typing import Final

import numpy as np

from drives.errors import DriveError
from gateway.check.stop import motion_station
from gateway.motion.opening import OpenArm
from gateway.motion.power import SAG_RAD, powered
from gateway.motion.stream import MoveOptions, Stream
from gateway.preflight.rules import CheckItem

#: How long each axis is watched [s].
WATCH_S: Final = 1.0
#: Share of an axis' torque limit that gravity may take where its brake is tried.
GRAVITY_SHARE: Final = 0.25


def try_brakes(opened: OpenArm, options: MoveOptions) -> list[CheckItem]:
    """Let each brake in turn hold its axis.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, in its brakes, in a posture with little gravity on the axes.
    options : MoveOptions

    Returns
    -------
    list of CheckItem
        One per axis; an axis on which gravity acts too much here is not tried, and that is said. After a brake that
        does not hold nothing is powered any more.

    Raises
    ------
    DriveError, KeyboardInterrupt
        The arm was stopped.
    """
    items: list[CheckItem] = []
    for axis in range(len(opened.config.axis)):
        items.append(_try_brake(opened, options, axis))
        if items[-1].severity == "fail":
            break
    return items


def _try_brake(opened: OpenArm, options: MoveOptions, axis: int) -> CheckItem:
    where = f"J{axis + 1} node {opened.config.axis[axis].node_id}"
    holding = opened.workspace.holding_torque(opened.arm.where()[None])
    limit_nm = float(opened.workspace.torque_nm[axis])
    if holding is not None and holding[0, axis] > GRAVITY_SHARE * limit_nm:
        what = f"its brake was not tried: gravity takes {holding[0, axis] / limit_nm:.0%} of its torque limit here"
        return CheckItem("warn", where, what, f"bring it to a posture with at most {GRAVITY_SHARE:.0%} and ask again")
    try:
        with powered(Stream(motion_station(opened, options))) as stream:
            stream.take_over()
            sag_rad = _at_joint(opened, axis, opened.group.release(axis, WATCH_S))
    except DriveError:
        # an axis that goes on sinking once all are disabled is no standstill
        sags = opened.arm.sag_rad()
        if sags.max() <= SAG_RAD:
            raise
        axis = int(np.argmax(sags))
        sag_rad, where = float(sags[axis]), f"J{axis + 1} node {opened.config.axis[axis].node_id}"
    if sag_rad > SAG_RAD:
        advice = "this brake does not hold: do not power this arm before it is repaired"
        return CheckItem("fail", where, f"sank by {sag_rad:.4f} rad in its brake, {SAG_RAD} rad are allowed", advice)
    return CheckItem("ok", where, f"its brake held it for {WATCH_S:g} s: it moved by {sag_rad:.4f} rad")


def _at_joint(opened: OpenArm, axis: int, motor_rad: float) -> float:
    """How far a joint turns at most with so much of one motor [rad]."""
    alone = np.zeros(len(opened.config.axis))
    alone[axis] = motor_rad
    return float(opened.arm.axes.joint_bound(alone).max())
