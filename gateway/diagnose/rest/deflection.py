"""Joint elasticity at rest from a secondary encoder: the wind-up is proportional to the torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.wind_up import wind_up
from gateway.identify.rest.linear import Fit, RestProblem, modelled
from gateway.result.result import EffectResult, Evidence


def elastic_joints(problem: RestProblem, after: Fit) -> list[EffectResult]:
    """Report elastic joints among those with a secondary encoder.

    The wind-up is regressed on the modelled torque, with a constant for the zeros of the two encoders. A joint is
    reported if the slope is significant and its neglect would be visible in the torque.
    """
    rows = problem.rows
    prediction = problem.model.predict(
        after.setting, after.links, problem.fixed_load + problem.member @ after.loads, after.band
    )
    out = []
    for axis in range(problem.axes):
        bend = rows.wind_up_rad[:, axis]
        if not np.isfinite(bend).all() or len(bend) < 4:
            continue
        found = wind_up(prediction.joint_nm[:, axis], bend, lambda _: 1.0, problem.axes)
        compliance, std = found.compliance_rad_nm, found.std_rad_nm
        if compliance < REST.wind_up * std or _strength(problem, after, axis, compliance) < REST.wind_up_strength:
            continue
        key, evidence = "compliance_rad_nm", Evidence(p_value=found.p_value)
        out.append(EffectResult("joint_elasticity", (axis + 1,), {key: compliance}, {key: std}, evidence))
    return out


def _strength(problem: RestProblem, after: Fit, axis: int, compliance: float) -> float:
    """Torque error without the secondary encoder, over the noise, on the axis where it is largest."""
    soft = after.setting.compliance_rad_nm.copy()
    soft[axis] -= compliance
    stiff = modelled(problem, after.setting, after.links, after.loads, after.band)
    other = modelled(problem, replace(after.setting, compliance_rad_nm=soft), after.links, after.loads, after.band)
    missed = (other - stiff) / after.noise.std[problem.group]
    return float(np.sqrt((problem.by_group(missed**2) / np.maximum(problem.by_group(), 1)).max()))
