"""Small moves of every axis: compare signs, order, gear ratios and the source of the torque with the model.

Each axis in turn is displaced a little. Every posture is approached slowly in both directions, settled and averaged,
with all limits monitored as in a recording. Nothing is stored; demand and current of the drives are recorded as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from drives.busload import LOAD_LIMIT_PERCENT, frame_bits_worst, load_percent
from drives.torque_signals import TorqueSignalReader, TorqueSignals
from gateway.acquire.events import Listener
from gateway.acquire.plan import SIDES, Plan, VisitSettings, plan_poses
from gateway.acquire.run_loop import Run, rest_visits
from gateway.acquire.visit_store import MemoryStore
from gateway.check.torque import judge_torque
from gateway.check.wiring import Moves, Verdict, Wiring, WiringView, judge_wiring
from gateway.data.rest_pose import RestPose
from gateway.errors import LimitExceeded, WrongPlace
from gateway.motion.assumed import reference_load
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import Workspace, refuse_start
from gateway.preflight.rules import Axis
from gateway.result.interval import SAID
from gateway.result.numerals import with_interval
from gateway.result.result import Finding

#: Displacement of an axis [rad] of the first three at least, and of the last three beyond them: the wrist sees little
#: gravity and reaches little.
STEP_RAD, WRIST_STEP_RAD, WRIST_AXES = 0.15, 0.3, 3
APPROACH_RAD: Final = 0.03
SPEED_RAD_S: Final = 0.05
SAMPLES: Final = 20
SETTLE_S: Final = 10.0
#: Misfit above which the model does not describe the arm with any wiring.
MISFIT: Final = 2.0
LOAD: Final = "check"


def plan_moves(arm: str, workspace: Workspace, start_rad: np.ndarray, period_s: float) -> Plan:
    """Return a plan of the present posture and one displacement of each axis.

    Parameters
    ----------
    arm : str
    workspace : Workspace
    start_rad : array of shape (N,)
    period_s : float
        SYNC period.

    Raises
    ------
    WrongPlace
        An axis cannot move in either direction, or the arm is outside its joint range.
    PlanRefused
        The arm is in a posture that is not allowed.
    """
    refuse_start(workspace, start_rad, arm)
    inward = np.where(start_rad > (workspace.lower_rad + workspace.upper_rad) / 2, -1.0, 1.0)
    postures = [start_rad]
    for joint, line in enumerate(inward * np.eye(len(start_rad))):
        size = step_rad(joint, len(start_rad))
        for target in (start_rad + size * line, start_rad - size * line):
            # room for both approach directions
            ends = np.array([target + APPROACH_RAD, target - APPROACH_RAD])
            if workspace.path_clear(np.array([start_rad, start_rad]), ends).all():
                postures.append(target)
                break
        else:
            raise WrongPlace(
                f"arm '{arm}', joint {joint + 1}: no room for {size} rad in either direction; move the arm to a posture"
                " away from limits and obstacles",
                arm,
            )
    poses = [RestPose(number, tuple(q_rad.tolist()), "fit") for number, q_rad in enumerate(postures, start=1)]
    settings = VisitSettings(APPROACH_RAD, SPEED_RAD_S, SETTLE_S, SAMPLES, period_s)
    plan, unreachable = plan_poses(arm, workspace, poses, settings)
    if unreachable:
        raise WrongPlace(
            f"arm '{arm}': no free path for the small moves; move the arm to a posture with more free space", arm
        )
    return plan


def step_rad(joint: int, axes: int) -> float:
    """Return the displacement [rad] of a joint (index from 0)."""
    return WRIST_STEP_RAD if joint >= max(WRIST_AXES, axes - WRIST_AXES) else STEP_RAD


def check_moves(
    opened: OpenArm, listeners: Sequence[Listener] = (), options: MoveOptions | None = None
) -> list[Finding]:
    """Move every axis a little and compare the torques with the model.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, brakes on; the stop on loss of the master has been tested.
    listeners : sequence of Listener
    options : MoveOptions, optional

    Raises
    ------
    PlanRefused
        No free motion, or a pose does not settle.
    DriveError, KeyboardInterrupt
        The arm was stopped.
    """
    group, config = opened.group, opened.config
    plan = plan_moves(config.name, opened.workspace, opened.arm.where(), group.timing.period_s)
    visits = MemoryStore()
    with TorqueSignalReader(group.bus, group.drives if _bus_has_capacity(opened) else ()) as reader:
        try:
            run = Run(opened.arm, opened.workspace, visits, listeners, options, group.timing.pacing)
            run.execute(rest_visits(plan, opened.arm, opened.workspace), LOAD)
        except LimitExceeded as error:
            if not group.gate().is_disabled:
                raise
            advice = "check the order of the node ids, position_sign, torque_sign and gear_ratio of the axes by hand"
            return [Finding("fail", f"J{error.joint}", f"small moves were stopped: {error}", advice)]
    items: list[Finding] = []
    nothing = [TorqueSignals(axis.node_id, missing="the bus has no capacity for a third TPDO") for axis in config.axis]
    for joint, (axis, profile, drive, words) in enumerate(
        zip(config.axis, opened.profiles, group.drives, reader.signals or nothing, strict=True), start=1
    ):
        items.append(judge_torque(Axis(joint, axis, profile), words, drive.scale.torque_nm, drive.scale.current_a))
    workspace = opened.workspace
    if workspace.links is None:
        what = "signs, order and gear ratios were not compared: the cell file ignores the inertials of the robot model"
        advice = 'set inertials = "prior:0.1" if the URDF has link masses'
        return [*items, Finding("warn", f"arm {config.name}", what, advice)]
    by_key = {(visit.pose, visit.approach): visit for visit in visits.visits}
    pairs = [[by_key[pose.number, side] for side in SIDES] for pose in plan.poses]
    motor_position = opened.arm.axes.motor_position
    moves = Moves(
        np.array([[motor_position(visit.q_rad.mean(axis=0)) for visit in pair] for pair in pairs]),
        np.array([[visit.motor_torque_nm.mean(axis=0) for visit in pair] for pair in pairs]),
    )
    verdict = judge_wiring(
        moves,
        workspace.robot,
        opened.arm.axes,
        gravity_m_s2=workspace.gravity_m_s2,
        torque_limit_nm=workspace.torque_nm,
        link_std=config.link_std,
        load_kg=reference_load(workspace, opened.arm.where()[None])[0],
    )
    return [*items, *wiring_items(config.name, [axis.node_id for axis in config.axis], verdict)]


def _bus_has_capacity(opened: OpenArm) -> bool:
    """Return True if, in real time, a third TPDO of every drive fits the bus."""
    timing, spec = opened.group.timing, opened.group.bus.spec
    bits = opened.group.cycle_bits + len(opened.group.drives) * frame_bits_worst(8)
    load = load_percent(bits, timing.period_s, spec.bitrate_bit_s)
    return timing.pacing == "lockstep" or load <= LOAD_LIMIT_PERCENT


# -------------------------------------------------------------------------------------------------------- in words


def wiring_items(arm: str, node_ids: Sequence[int], verdict: Verdict) -> list[Finding]:
    """Return a verdict as lines of the check.

    Parameters
    ----------
    arm : str
    node_ids : sequence of int, one per axis
    verdict : Verdict
    """
    items = [_found(node_ids, wiring, verdict) for wiring in verdict.found]
    if verdict.misfit > MISFIT:
        what = f"the torques differ from the model by {verdict.misfit:.1f} times the tolerance, with any wiring"
        advice = "check the URDF's link masses, gravity_m_s2, the mounted load, and the zero offsets"
        items.append(Finding("warn", f"arm {arm}", what, advice))
    changed = {joint for wiring in verdict.found for joint in wiring.joints}
    for joint, view in enumerate(verdict.axes, start=1):
        if joint not in changed:
            items.append(_seen(joint, node_ids, view))
    return items


def _found(node_ids: Sequence[int], wiring: Wiring, verdict: Verdict) -> Finding:
    joint = wiring.joints[0]
    where = f"J{joint} node {node_ids[joint - 1]}"
    rivals = [rival for rival in verdict.rivals if wiring is verdict.found[-1]]
    if wiring.name == "swapped":
        other = wiring.joints[1]
        what = f"the drives of J{joint} and J{other} are swapped"
        advice = f"exchange node ids {node_ids[joint - 1]} and {node_ids[other - 1]} in the cell file, or their cables"
        return Finding("fail", where, what + _or(rivals), advice)
    if wiring.name in ("gear_ratio", "torque_scale"):
        kind = "gear_ratio is" if wiring.name == "gear_ratio" else "torque reads"
        what = f"{kind} {wiring.factor:.2f} times the value that the model and the moves require"
        advice = (
            "correct gear_ratio" if wiring.name == "gear_ratio" else "check torque constant, rated torque, rms or peak"
        )
        return Finding("fail", where, what + _or(rivals), advice)
    words = {
        "reversed": ("turns in the opposite direction of the model", "change position_sign and torque_sign both"),
        "position_reversed": ("position sign is reversed", "change position_sign"),
        "torque_reversed": ("torque sign is reversed relative to position", "change torque_sign"),
    }
    what, advice = words[wiring.name]
    if any(rival.joints == wiring.joints for rival in rivals):
        what, advice = (
            "torque and position have opposite signs",
            "change torque_sign or position_sign: check the direction of rotation",
        )
        rivals = []
    return Finding("fail", where, what + _or(rivals), advice)


def _or(rivals: Sequence[Wiring]) -> str:
    """Return the hypotheses that explain the torques nearly as well."""
    if not rivals:
        return ""
    words = [
        f"{rival.name.replace('_', ' ')} of J{' and J'.join(str(joint) for joint in rival.joints)}"
        + (f" by {rival.factor:.2f}" if rival.factor != 1.0 else "")
        for rival in rivals[:3]
    ]
    return f" (or {', '.join(words)}: not distinguishable here)"


def _seen(joint: int, node_ids: Sequence[int], view: WiringView) -> Finding:
    where = f"J{joint} node {node_ids[joint - 1]}"
    parts = [f"torque and position have the same sign (friction {view.band_nm:.2g} Nm)"]
    if abs(view.band_nm) < 3.0 * view.band_std_nm:
        parts = [f"friction of {view.band_nm:.2g} Nm is too small to determine the sign of the torque"]
    missing = []
    if view.ratio_seen:
        ratio = with_interval(view.ratio, view.ratio_std)
        parts.append(f"the gear ratio of the cell file is {ratio} ({SAID}) times the estimated one")
    else:
        missing.append("gear ratio")
    if not view.sign_seen:
        missing.append("direction of rotation")
    if view.swaps_unseen:
        missing.append(f"a swap with {', '.join(f'J{other}' for other in view.swaps_unseen)}")
    if not missing:
        parts.append("direction of rotation and order agree with the model")
        return Finding("ok", where, "; ".join(parts))
    parts.append(f"gravity on this axis is too small in this posture to determine: {', '.join(missing)}")
    advice = (
        f"check by eye that joint {joint} turned by {step_rad(joint - 1, len(node_ids))} rad, in the positive"
        " direction of the model when its angle increased; or repeat with a load or in another posture"
    )
    return Finding("info", where, "; ".join(parts), advice)
