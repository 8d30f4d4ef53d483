"""Acceptance test of an entered load over the workspace: predict the torque at unseen poses, and judge the
difference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.data.rows import Table
from gateway.errors import DataUnusable, InputError
from gateway.estimate.posture import refuse_other_bare
from gateway.identify.stated_effects import stated_terms
from gateway.identify.workspace_error import (
    GUARD,
    WRONG_DECISION,
    EnteredLoad,
    WorkspaceError,
    error_families,
    inferred_error,
)
from gateway.model.kinematics import flange_frames, joint_axes_origins
from gateway.model.robot import reach_m
from gateway.model.visits import SAME_POSE_RAD, Gears, Visits, pair_visits
from gateway.pipeline.inputs import AnalysisInputs
from gateway.result.data_roles import CHOSEN_ON, FIT, VALIDATION, refuse_used, rows_in, used_rows
from gateway.result.result import Result

Floats = NDArray[np.float64]

#: Singular values of the flange's Jacobian below this share of the largest carry no equivalent force.
_LEAST_SINGULAR: Final = 0.05
_AGAIN: Final = "measure the unloaded arm and the load in one run, and estimate with --cell"


def entered_load(result: Result, label: str | None, about: AnalysisInputs) -> EnteredLoad:
    """Return the prediction model of a result: the arm with one of its loads.

    Raises
    ------
    InputError
        The result is of another arm, lacks the load, has several loads and none is named, or the load is too heavy.
    DataUnusable
        The load is incomplete, or the unloaded arm was not identified with the model used here.
    """
    loads = {load.label: load for load in result.loads}
    if label is None and len(loads) != 1:
        raise InputError(f"the result holds the loads {', '.join(loads) or 'none'}: name one of them by --load")
    load = next(iter(loads.values())) if label is None else loads.get(label)
    if load is None:
        raise InputError(f"load '{label}' is not in the result; it holds {', '.join(loads) or 'none'}")
    if load.refused or not all(map(math.isfinite, (load.mass_kg, *(load.com_m or (math.nan,))))):
        raise DataUnusable(
            f"load '{load.label}' is not completely identified: {load.refused or ', '.join(load.unidentifiable)}"
        )
    wrong = about.load_bounds.violation(load.mass_kg, load.com_m or ())
    if wrong:
        raise InputError(f"load '{load.label}': {wrong}")
    if result.verdict == "undecided" and result.effects:
        names = ", ".join(sorted({effect.name for effect in result.effects}))
        raise DataUnusable(f"the result does not decide between the effects {names}: measure the poses under `next`")
    if not result.data_roles:
        raise DataUnusable("the result does not state which data it was fitted to: estimate again and name that file")
    if result.bare is None:
        raise DataUnusable(f"the result holds no identification of the unloaded arm: {_AGAIN}")
    refuse_other_bare(result.bare, about.model, about.knowledge.gravity_m_s2)
    if not all(map(math.isfinite, result.noise_floor_nm)) or len(result.noise_floor_nm) != about.model.axes:
        raise DataUnusable(
            f"the result states no noise floor for every axis: {_AGAIN}, and approach each pose in both directions"
        )
    gears = Gears.of(about.knowledge.efficiency, about.model.axes, about.knowledge.coupling)
    effects = stated_terms(result.effects, gears, about.model.axes)
    return EnteredLoad(about.model, result.bare, load, effects, gears, np.array(result.friction_band_nm, dtype=float))


def parse_tolerance(text: str, arm: ArmConfig) -> Floats:
    """Return the tolerance (N,) [Nm] of `P%` of each torque limit, or of one number per axis [Nm].

    Raises
    ------
    InputError
    """
    limits = np.array([axis.torque_limit_nm for axis in arm.axis])
    try:
        share = float(text[:-1]) / 100.0 if text.endswith("%") else None
        values = np.array([float(word) for word in text.split(",")]) if share is None else share * limits
    except ValueError:
        values = np.zeros(0)
    if values.shape != limits.shape or not (np.isfinite(values) & (values > 0) & (values <= limits)).all():
        raise InputError(
            f"--tolerance {text}: give P% of the torque limit of every axis, or {len(limits)} torques in Nm, such as "
            f"3% or {','.join(f'{0.03 * limit:.3g}' for limit in limits)}"
        )
    return values


def unseen(result: Result, q_rad: Floats) -> NDArray[np.bool_]:
    """Return a mask (n,) of the postures (n, N) that are not among those of the result."""
    seen = seen_postures(result, q_rad.shape[1])
    return np.abs(q_rad[:, None] - seen[None]).max(axis=2).min(axis=1, initial=np.inf) >= SAME_POSE_RAD


def seen_postures(result: Result, axes: int) -> Floats:
    """Return the postures (k, N) [rad] that a result was fitted to or chosen on."""
    return np.vstack([rows_in(result.data_roles, (FIT, CHOSEN_ON), kind, axes)[0] for kind in ("", "moving_")])


def accepted_over(
    result: Result,
    entered: EnteredLoad,
    about: AnalysisInputs,
    table: Table,
    tolerance_nm: Floats,
    postures_rad: Floats,
) -> dict[str, Any]:
    """Return the outcome with the probability of a wrong decision, the residuals by pose, and the map.

    Parameters
    ----------
    result : Result
    entered : EnteredLoad
    about : AnalysisInputs
    table : Table
        Samples of unseen poses under the load.
    tolerance_nm : array of shape (N,)
    postures_rad : array of shape (m, N)
        Postures that represent the workspace.

    Raises
    ------
    DataUnusable
        No unseen pose under the load, an axis was not measured, or a visit that the result was fitted to or chosen on.
    """
    label = entered.load.label
    stated = about.knowledge
    judged = table.take((table.load == label) & ~table.moving)
    refuse_used(judged, used_rows(judged, result.data_roles, (FIT, CHOSEN_ON)), "the fit of the result")
    visits = pair_visits(judged, stated.efficiency, stated.coupling)
    visits = visits.take(unseen(result, visits.q_rad))
    if not len(visits) or not np.isfinite(visits.sum_nm).all():
        raise DataUnusable(
            f"the data hold no unseen pose under load '{label}' with the torque of every axis; measure one"
        )
    q_rad = np.vstack([postures_rad, visits.q_rad])
    residual_nm = visits.sum_nm - entered.torque(visits.q_rad)
    noise = np.array(result.noise_floor_nm) / tolerance_nm
    measured = np.arange(len(postures_rad), len(q_rad))
    found = inferred_error(error_families(entered, q_rad, tolerance_nm), measured, residual_nm / tolerance_nm, noise)
    return {
        "schema": 1,
        "robot": entered.robot.name,
        "load": label,
        "mass_kg": entered.load.mass_kg,
        "outcome": found.outcome,
        "probability_of_wrong_decision": found.wrong_decision,
        "largest_wrong_decision": WRONG_DECISION,
        "probability_beyond_tolerance": found.exceeds,
        "likeliest_error": found.likeliest or None,
        "probability_of_likeliest_error": found.odds,
        "tolerance_nm": tolerance_nm.tolist(),
        "noise_floor_nm": list(result.noise_floor_nm),
        "visits_that_judged_before": int(used_rows(judged, result.data_roles, (VALIDATION,)).sum()),
        "poses": _poses(entered, visits, residual_nm),
        "map": _map(entered, q_rad, found),
    }


def _poses(entered: EnteredLoad, visits: Visits, residual_nm: Floats) -> list[Mapping[str, Any]]:
    """Return the residual of each pose, and the equivalent force and moment at the flange."""
    force_n, moment_nm = flange_equivalent(entered, visits.q_rad, residual_nm)
    places = flange_frames(entered.robot, visits.q_rad)[:, :3, 3]
    return [
        {
            "pose": int(visits.pose[row]),
            "q_rad": visits.q_rad[row].tolist(),
            "residual_nm": residual_nm[row].tolist(),
            "flange_force_n": float(force_n[row]),
            "flange_moment_nm": float(moment_nm[row]),
            "flange_m": places[row].tolist(),
        }
        for row in range(len(visits))
    ]


def flange_equivalent(entered: EnteredLoad, q_rad: Floats, torque_nm: Floats) -> tuple[Floats, Floats]:
    """Return the force (n,) [N] and moment (n,) [Nm] at the flange equivalent to a torque (n, N): `J' w = tau`.

    Near a singular posture, the part of the torque that no moderate force explains is left out.
    """
    axes, origins = joint_axes_origins(entered.robot, q_rad)
    place = flange_frames(entered.robot, q_rad)[:, None, :3, 3]
    length_m = reach_m(entered.robot)
    # rows of J': torque of each joint per force, and per moment over the reach of the arm
    jacobian = np.concatenate([np.cross(axes, place - origins) / length_m, axes], axis=2)
    wrench = np.einsum("nij,nj->ni", np.linalg.pinv(jacobian, rcond=_LEAST_SINGULAR), torque_nm / entered.factor())
    return np.linalg.norm(wrench[:, :3], axis=1) / length_m, np.linalg.norm(wrench[:, 3:], axis=1)


def _map(entered: EnteredLoad, q_rad: Floats, found: WorkspaceError) -> list[Mapping[str, Any]]:
    """Return flange position, error and guard band relative to the tolerance on the worst axis, for every posture."""
    places = flange_frames(entered.robot, q_rad)[:, :3, 3]
    worst = np.argmax(np.abs(found.mean) + GUARD * found.std, axis=1)
    rows = np.arange(len(q_rad))
    error, guard = np.abs(found.mean[rows, worst]), GUARD * found.std[rows, worst]
    return [
        {
            "flange_m": places[row].tolist(),
            "joint": int(worst[row]) + 1,
            "error": float(error[row]),
            "guard": float(guard[row]),
        }
        for row in rows
    ]
