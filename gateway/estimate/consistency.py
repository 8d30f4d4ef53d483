"""Plausibility of an estimated load: agreement between the poses, and centre of mass within reach of the flange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gateway.identify.load_estimate import LoadEstimate
from gateway.model.robot import Robot, reach_m
from gateway.result.interval import half_width, holds_zero
from gateway.result.result import Finding

#: Residual over the noise of other rows above which a load's data are refused.
CONTRADICTS = 5.0
_FAR = 0.5
_SHARE = 0.2
_HULL_SHARE = 0.4


def disagree(masses_kg: Sequence[float]) -> bool:
    """Return True if a fifth of the poses (at least two) give masses off the median by half of it or more."""
    values = np.asarray(masses_kg, dtype=float)
    if len(values) < 3:
        return False
    middle = float(np.median(values))
    far = int((np.abs(values - middle) > _FAR * abs(middle)).sum())
    return far >= max(2, int(np.ceil(_SHARE * len(values))))


def describe_masses(masses_kg: Mapping[str, float]) -> str:
    """Return the text for the range of the masses that single poses give."""
    values = np.array(list(masses_kg.values()))
    return f"{values.min():.3g} to {values.max():.3g} kg (median {np.median(values):.3g})"


def hull_radius_m(robot: Robot) -> float:
    """Distance from the last link within which a load's centre of mass is expected [m]."""
    return max(_HULL_SHARE * reach_m(robot), 0.1)


def physical_findings(load: LoadEstimate, frame: str, radius_m: float) -> list[Finding]:
    """Report implausible values of a load whose centre is given in the named frame; no value is changed."""
    where, out = f"load {load.label}", []
    if load.inertia is not None and not load.inertia.free:
        out.append(
            Finding("info", where,
                    "the unconstrained fit gives an inertia that no rigid body has; the nearest "
                    "physical inertia within the uncertainty is reported",
                    "turn the wrist faster, about more than one axis, where the inertia matters")
        )  # fmt: skip
    if holds_zero(load.mass_kg, load.mass_std_kg):
        return out  # nothing has no centre
    distance = float(np.linalg.norm(load.com_m))
    slack = half_width(float(np.linalg.norm(load.com_std_m))) if np.isfinite(load.com_std_m).all() else 0.0
    if np.isfinite(distance) and distance > radius_m:
        margin = "" if distance - slack > radius_m else ", but within its uncertainty it may be inside"
        out.append(
            Finding("warn", where,
                    f"centre of mass is {distance:.2f} m from {frame}, outside a sphere of {radius_m:.2f} m{margin}",
                    "not believable for a tool: the model may lack an effect (diagnose)")
        )  # fmt: skip
    return out
