"""Effects at rest that are measured directly, beside the search.

A secondary encoder shows the elasticity of its joint. One-sided visits with both approach directions show friction that
differs by direction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.wind_up import elastic, wind_up
from gateway.identify.rest.linear import Fit, RestProblem, certain_bands, modelled, visit_loads
from gateway.result.result import EffectResult, Evidence


def elastic_joints(problem: RestProblem, after: Fit) -> list[EffectResult]:
    """Report elastic joints among those with a secondary encoder.

    The wind-up is regressed on the modelled torque, with a constant for the zeros of the two encoders. A joint is
    reported if the slope is significant and its neglect would be visible in the torque.
    """
    rows = problem.rows
    loads = visit_loads(problem, after.loads)
    torque = problem.model.predict(after.setting, after.links, loads, after.band).joint_nm
    out = []
    for axis in range(problem.axes):
        bend = rows.wind_up_rad[:, axis]
        if not np.isfinite(bend).all() or len(bend) < 4:
            continue
        compliance, std, p_value = wind_up(torque[:, axis], bend, lambda _: 1.0, problem.axes)
        if compliance < REST.wind_up * std or _strength(problem, after, axis, compliance) < REST.wind_up_strength:
            continue
        out.append(elastic(axis, compliance, std, Evidence(p_value=p_value)))
    return out


def _strength(problem: RestProblem, after: Fit, axis: int, compliance: float) -> float:
    """Torque error without the secondary encoder, over the noise, on the axis where it is largest."""
    soft = after.setting.compliance_rad_nm.copy()
    soft[axis] -= compliance
    stiff = modelled(problem, after.setting, after.links, after.loads, after.band)
    other = modelled(problem, replace(after.setting, compliance_rad_nm=soft), after.links, after.loads, after.band)
    missed = (other - stiff) / after.noise.std[problem.group]
    return float(np.sqrt((problem.by_group(missed**2) / np.maximum(problem.by_group(), 1)).max()))


def friction_by_direction(problem: RestProblem, after: Fit) -> list[EffectResult]:
    """Report axes whose mean friction against the approach is significant in one-sided visits.

    In a two-sided visit this friction is the friction band, which every model has. A single one-sided visit cannot
    separate it from torque, but visits with both approach directions together can.
    """
    rows, certain = problem.rows, certain_bands(problem, after)
    at, axes = problem.band_part.start, problem.axes
    out = []
    for axis in range(axes):
        side = rows.side[problem.use_sum[:, axis], axis]
        if min(int((side > 0).sum()), int((side < 0).sum())) < REST.each_side:
            continue
        bias, std = float(after.band[axis]), float(np.sqrt(max(after.covariance[at + axis, at + axis], 0.0)))
        noise = float(after.noise.std[2 * axes + axis])
        if certain[axis] < REST.bias or bias < REST.bias_strength * noise:
            continue
        ratio = noise / float(np.hypot(noise, bias))
        evidence = Evidence(holdout_rms_ratio=ratio, p_value=float(max(axes * ndtr(-certain[axis]), 1e-300)))
        out.append(EffectResult("static_friction", (axis + 1,), {"bias_nm": bias}, {"bias_nm": std}, evidence))
    return out
