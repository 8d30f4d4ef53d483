"""Small moves of every axis: compare signs, order, gear ratios and the source of the torque with the model.

Each axis in turn is displaced a little. Every posture is approached slowly in both directions, settled and averaged,
with all limits monitored as in a recording. Nothing is stored; demand and current of the drives are recorded as well.

`judge_torque` compares the torque object of the profile with them, sampled at the same time. A torque that is the
demand has identical bits. A torque that has lost its sign keeps it while the demand changes sign. A wrong rated current
or unit shows as a factor between torque and current.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from drives.busload import LOAD_LIMIT_PERCENT, frame_bits_worst, load_percent
from drives.objects import OBJECTS
from drives.torque_signals import TorqueSignalReader, TorqueSignals
from gateway.acquire.events import Listener
from gateway.acquire.plan import SIDES, Plan, VisitSettings, plan_poses
from gateway.acquire.run_loop import Run, rest_visits
from gateway.acquire.visit_store import MemoryStore
from gateway.check.wiring import Moves, Verdict, Wiring, WiringView, judge_wiring
from gateway.data.visit import RestPose
from gateway.errors import LimitExceeded, WrongPlace
from gateway.motion.assumed import reference_load
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import Workspace, refuse_start
from gateway.preflight.rules import Axis
from gateway.result.finding import Finding, Severity
from gateway.result.numerals import SAID, with_interval

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


# ------------------------------------------------------------------------------------- source of the torque value

#: Smallest number of SYNCs and of different values for a decision.
LEAST: Final = 200
LEAST_VALUES: Final = 10
#: Share of SYNCs at which a measured torque may equal the demand by chance.
EQUAL_SHARE: Final = 0.98
#: Distance of the demand from zero, in standard deviations, from which its sign is significant.
CLEAR: Final = 0.25
#: Correlation from which two signals count as equal in shape.
FOLLOWS: Final = 0.8
SIGN_SHARE: Final = 0.05
#: Relative tolerance of the factor between torque and current: for one, and for a known factor.
SAME: Final = 0.1
EXACT: Final = 0.04
FACTORS: Final = (
    (
        math.sqrt(2.0),
        "sqrt(2): an rms value is taken for a peak value",
        "correct current_reference or torque_constant_per",
    ),
    (
        math.sqrt(0.5),
        "1/sqrt(2): a peak value is taken for an rms value",
        "correct current_reference or torque_constant_per",
    ),
    (1000.0, "1000: mNm taken for uNm, or A for mA", "correct unit of [torque.rated] or [current.rated]"),
    (0.001, "1/1000: uNm taken for mNm, or mA for A", "correct unit of [torque.rated] or [current.rated]"),
)


def judge_torque(axis: Axis, signals: TorqueSignals, torque_nm: float, current_a: float | None) -> Finding:
    """Determine the source of the torque value of one drive.

    Parameters
    ----------
    axis : Axis
    signals : TorqueSignals
        Recorded while the axis moved in both directions.
    torque_nm : float
        Torque per bit of the torque object, motor side.
    current_a : float or None
        Current per bit of the current object; None = unit not known.
    """
    reference = axis.profile.torque.object
    address, torque = (reference.index, reference.subindex), np.array(signals.torque, dtype=float)
    if signals.missing or len(torque) < LEAST:
        what = f"torque could not be compared with demand and current: {signals.missing or 'too few answers'}"
        return axis.item("warn", address, what, "allow 0x1802 and 0x1A02 in the profile, if the drive has a third TPDO")
    others = {"demand": np.array(signals.demand, dtype=float), "current": np.array(signals.current, dtype=float)}
    compared = {name: values for name, values in others.items() if len(values) == len(torque)}
    if len(np.unique(torque)) < LEAST_VALUES:
        what = f"the torque showed {len(np.unique(torque))} different values in {len(torque)} SYNCs of motion"
        advice = "this is not a live measurement: look up the object of the measured torque in the drive's manual"
        return axis.item("fail", address, what, advice)
    fault = _against_demand(torque, compared["demand"]) if "demand" in compared else None
    if fault is None and "current" in compared:
        current_nm = None if current_a is None else current_a * axis.config.torque_constant_nm_per_a.value
        fault = _against_current(torque, compared["current"], torque_nm, current_nm)
    if fault is not None:
        severity, what, advice = fault
        return axis.item(severity, address, what, advice)
    if not compared:
        return axis.item("warn", address, "the drive has neither demand nor current to compare the torque with")
    what = f"a measured torque: compared with {' and '.join(compared)} at {len(torque)} SYNCs"
    if torque.min() < 0:
        return axis.item("ok", address, f"{what}; it has a sign")
    what = f"{what}; it was never negative in this motion, so a lost sign would not be detected"
    return axis.item("info", address, what)


def _against_demand(torque: np.ndarray, demand: np.ndarray) -> tuple[Severity, str, str] | None:
    name = OBJECTS["torque_demand"]
    if len(np.unique(demand)) < LEAST_VALUES:
        return None
    # equal except for unit and rounding
    factor = float(torque @ demand) / float(demand @ demand)
    same = float(np.mean(np.abs(torque - factor * demand) <= 0.5 * max(1.0, abs(factor)) + 1e-9))
    if same > EQUAL_SHARE:
        what = f"equals the demand {name} at {100 * same:.0f} % of {len(torque)} SYNCs, also in motion: it is a demand"
        advice = "name the object of the measured torque or current in the profile; this one only repeats the demand"
        return "fail", what, advice
    if _lost_its_sign(torque, demand):
        what = f"never changes its sign, while the demand {name} does: it shows the magnitude only"
        return "fail", what, "name a signed object in the profile, or read the word as signed (i16)"
    r = _correlation(torque, demand)
    if r >= -FOLLOWS:
        return None
    if torque.min() >= 0:
        what = f"is positive, while the demand {name} is negative: its sign is lost or reversed"
        advice = "name a signed object in the profile; check the polarity in the drive (0x607E) and torque_sign"
        return "fail", what, advice
    what = f"has the opposite sign of the demand {name} (r = {r:.2f})"
    return "fail", what, "correct the polarity in the drive (0x607E); then check torque_sign"


def _against_current(
    torque: np.ndarray, current: np.ndarray, torque_nm: float, current_nm: float | None
) -> tuple[Severity, str, str] | None:
    name = OBJECTS["current"]
    if _lost_its_sign(torque, current):
        return "fail", f"never changes its sign, while the current {name} does", "name a signed object in the profile"
    if current_nm is None or abs(_correlation(torque, current)) < FOLLOWS:
        return None
    across, along = torque * torque_nm, current * current_nm
    factor = float(across @ along / (along @ along))
    if abs(abs(factor) - 1.0) < SAME and factor > 0:
        return None
    for value, reason, advice in FACTORS:
        if abs(factor / value - 1.0) < EXACT:
            return "fail", f"is {factor:.4g} times current x torque constant, {reason}", advice
    what = f"is {factor:.3g} times current {name} x torque constant"
    return "warn", what, "check torque_constant_nm_per_a, rated torque and rated current"


def _lost_its_sign(torque: np.ndarray, signed: np.ndarray) -> bool:
    """Return True if the torque keeps its sign while a signal of the same magnitude changes it."""
    clear = CLEAR * float(np.abs(signed).std() + np.abs(signed.mean()))
    both = min(float(np.mean(signed > clear)), float(np.mean(signed < -clear))) > SIGN_SHARE
    return bool((torque >= 0).all() and both) and _correlation(torque, np.abs(signed)) > FOLLOWS


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    spread = float(first.std() * second.std())
    return 0.0 if spread == 0.0 else float(np.mean((first - first.mean()) * (second - second.mean())) / spread)
