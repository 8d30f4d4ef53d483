"""Proposed values: from the robot description or the drives, otherwise marked as assumed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drives.profile import DriveProfile, is_assumed
from gateway.cell.quantities import inertials_text
from gateway.identify.links import default_link_std
from gateway.model.placeholders import effort_placeholder, mass_placeholder
from gateway.model.robot import Robot
from gateway.model.urdf import FLANGES, flange_kind
from gateway.newcell.answers import ASSUMED, Answer
from gateway.newcell.nodes import SeenNode
from gateway.result.inertia import zyx_degrees

#: Assumed gear efficiency; harmonic and cycloidal gears have 0.65 to 0.9 at rated torque.
GEAR_EFFICIENCY = 0.8
#: Speed limit for the first motion of an arm [rad/s].
FIRST_SPEED_RAD_S = 0.5
#: Placeholder efforts of URDF exporters; motion is refused until they are confirmed.
PLACEHOLDER = f"{ASSUMED}, a placeholder"
#: 0x607E: the drive inverts positions.
_POSITION_REVERSED = 0x80


@dataclass(frozen=True, slots=True)
class Axes:
    """Known data of the axes: device and profile of each, gear ratios."""

    nodes: Sequence[SeenNode | None]
    profiles: Sequence[DriveProfile]
    ratio: Sequence[float] = ()


def node_order(seen: Sequence[SeenNode], axes: int) -> Answer | None:
    """Return node ids in ascending order, if there is one per axis."""
    ids = sorted(node.node_id for node in seen if node.node_id is not None)
    return Answer(tuple(ids), f"{ASSUMED}: ascending from the base") if len(ids) == axes else None


def stored_order(in_files: Sequence[SeenNode], axes: int) -> Answer | None:
    """Return the node ids of the DCF files, in file order."""
    ids = tuple(node.node_id for node in in_files if node.node_id is not None)
    names = ", ".join(node.name for node in in_files)
    return Answer(ids, f"read from {names}") if len(ids) == len(in_files) == axes else None


def profile_names(nodes: Sequence[SeenNode | None]) -> Answer | None:
    """Return the profile of each device: matched by identity, otherwise assumed."""
    if any(node is None or not node.profiles for node in nodes):
        return None
    names = tuple(node.profiles[0] for node in nodes if node is not None)
    is_identified = all(
        node is not None and node.identity.vendor_id is not None and not node.profiles[0].startswith("generic")
        for node in nodes
    )
    return Answer(names, "read from drive, 0x1018" if is_identified else f"{ASSUMED}: no profile for this manufacturer")


def gear_ratio(axes: Axes) -> Answer | None:
    """Return the gear ratio of the drives (0x6091), if it is not 1:1."""
    ratios: list[float] = []
    for node in axes.nodes:
        motor = None if node is None else node.read("gear_motor_revolutions")
        shaft = None if node is None else node.read("gear_shaft_revolutions")
        if motor is None or shaft is None or shaft.value <= 0 or motor.value == shaft.value:
            return None
        ratios.append(motor.value / shaft.value)
    return Answer(tuple(ratios), "read from drive, 0x6091")


def torque_constant(axes: Axes) -> Answer | None:
    """Return rated torque over rated current; valid only if both are motor ratings."""
    found: list[float] = []
    for node, profile in zip(axes.nodes, axes.profiles, strict=True):
        torque = None if node is None else profile.rated_torque_nm(node.number)
        current = None if node is None else profile.rated_current_a(node.number)
        if torque is None or current is None:
            return None
        found.append(torque / current)
    return Answer(tuple(found), f"{ASSUMED}: rated torque over rated current of the drive")


def position_limits(robot: Robot, axes: Axes, sign: Sequence[float], zero_rad: Sequence[float]) -> Answer | None:
    """Return the joint ranges of the URDF, narrowed by those of the drives; None if neither has one."""
    found: list[tuple[float, float]] = []
    sources: list[str] = []
    for joint in range(robot.axes):
        low, high = float(robot.lower_rad[joint]), float(robot.upper_rad[joint])
        own = _drive_range_rad(axes, joint, sign[joint], zero_rad[joint])
        narrowed = (low, high) if own is None else (max(low, own[0]), min(high, own[1]))
        if not narrowed[0] < narrowed[1]:
            narrowed, own = (low, high), None
        if not (math.isfinite(narrowed[0]) and math.isfinite(narrowed[1])):
            return None
        found.append(narrowed)
        sources.append("URDF" if own is None or narrowed == (low, high) else "URDF and drive, 0x607D")
    source = "URDF and drive, 0x607D" if "URDF and drive, 0x607D" in sources else "URDF"
    return Answer(tuple(found), source)


def _drive_range_rad(axes: Axes, joint: int, sign: float, zero_rad: float) -> tuple[float, float] | None:
    """Return the joint range of the drive (0x607D); None if missing or ambiguous."""
    node, profile, ratio = axes.nodes[joint], axes.profiles[joint], axes.ratio[joint]
    low, high = (None, None) if node is None else (node.read("position_limit_min"), node.read("position_limit_max"))
    if node is None or low is None or high is None or not low.value < high.value:
        return None
    if is_assumed(low.source) or _shifted(node):
        return None
    counts = profile.position.counts(node.number)
    if counts is None:
        return None
    ends = [zero_rad + sign / ratio * 2.0 * math.pi * end.value / counts for end in (low, high)]
    # within the drive range, so that a stop that begins at the limit ends before the drive faults
    margin = min(0.05, 0.01 * abs(ends[1] - ends[0]))
    return _rounded(min(ends) + margin), _rounded(max(ends) - margin)


def _shifted(node: SeenNode) -> bool:
    home, polarity = node.read("home_offset"), node.read("polarity")
    return bool(home and home.value) or bool(polarity and polarity.value & _POSITION_REVERSED)


def speed_limits(robot: Robot, axes: Axes) -> Answer:
    """Return a slow speed limit for the first motion, within the limits of robot and motors."""
    found: list[float] = np.fmin(FIRST_SPEED_RAD_S, robot.velocity_rad_s).tolist()  # NaN: the robot states none
    for joint, node in enumerate(axes.nodes):
        motor = None if node is None else node.read("max_motor_speed")
        if motor is not None and motor.value > 0:
            found[joint] = min(found[joint], _rounded(motor.value * math.pi / 30.0 / abs(axes.ratio[joint])))
    return Answer(tuple(found), f"{ASSUMED}: slow for a first motion, at most {FIRST_SPEED_RAD_S:g} rad/s")


def torque_limits(robot: Robot, axes: Axes) -> Answer | None:
    """Return the efforts of the URDF, limited by the drives (0x6072); without efforts the drive limits.

    Placeholder efforts are proposed as such, unless the drives limit every axis to less.
    """
    found: list[float] = []
    by_drive: list[bool] = []
    for joint in range(robot.axes):
        effort_nm, most_nm = float(robot.effort_nm[joint]), _drive_torque_nm(axes, joint)
        bounds = [effort_nm] if 0.0 < effort_nm < math.inf else []
        bounds += [] if most_nm is None else [most_nm]
        if not bounds:
            return None
        found.append(min(bounds))
        by_drive.append(most_nm is not None and most_nm <= min(bounds))
    why = effort_placeholder(robot)
    if all(by_drive) and (why or not np.isfinite(robot.effort_nm).all()):
        return Answer(tuple(found), f"{ASSUMED}: drive limit (0x6076, 0x6072) times gear ratio")
    if why:
        return Answer(tuple(found), f"{PLACEHOLDER}: {why}")
    if np.isfinite(robot.effort_nm).all():
        return Answer(tuple(found), "URDF" if tuple(found) == tuple(robot.effort_nm) else "URDF and drive, 0x6072")
    return Answer(tuple(found), f"{ASSUMED}: drive limit (0x6076, 0x6072) times gear ratio")


def _drive_torque_nm(axes: Axes, joint: int) -> float | None:
    """Return the joint torque limit of the drive: rated torque x 0x6072 x gear ratio."""
    node, profile = axes.nodes[joint], axes.profiles[joint]
    limit = None if node is None else node.read("max_torque")
    rated = None if node is None else profile.rated_torque_nm(node.number)
    if limit is None or rated is None or limit.value <= 0:
        return None
    return _rounded(rated * limit.value / 1000.0 * abs(axes.ratio[joint]))


def _rounded(value: float) -> float:
    """Round to four digits towards zero, so that the source value is not exceeded."""
    if value == 0.0:
        return value
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 3)
    return math.trunc(value / step) * step


def inertials(robot: Robot) -> Answer:
    """Return the uncertainty of the link masses of the description."""
    what, why = inertials_text(default_link_std(robot)), mass_placeholder(robot)
    if why:
        return Answer("ignore", f"{PLACEHOLDER}: {why}")
    return Answer(
        what, "no masses in the description" if what == "ignore" else f"{ASSUMED}: masses from the manufacturer's URDF"
    )


def flange_frame(robot: Robot) -> tuple[Answer, Answer] | None:
    """Return position and orientation of `tool0` or `flange` in the last link, or None."""
    found = [(kind, name, pose) for name, pose in robot.frames if (kind := flange_kind(name)) is not None]
    if not found:
        return None
    _, name, pose = min(found, key=lambda each: FLANGES.index(each[0]))
    source = f"URDF, frame {name}"
    return _vector(pose[:3, 3], source), _vector(np.radians(zyx_degrees(pose[:3, :3]))[::-1], source)


def _vector(values: NDArray[np.float64], source: str) -> Answer:
    return Answer(tuple(round(float(value), 9) + 0.0 for value in values), source)


def everywhere(value: object, axes: int, why: str) -> Answer:
    """Return the same assumed value for all axes."""
    return Answer((value,) * axes, f"{ASSUMED}: {why}")
