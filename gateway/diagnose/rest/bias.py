"""Direction-dependent static friction, detected from one-sided visits with both approach directions."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.linear import Fit, RestProblem, certain_bands
from gateway.result.result import EffectResult, Evidence


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
