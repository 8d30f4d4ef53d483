"""Small series for tests: joints swing about home, at rest where a period begins and ends."""

from __future__ import annotations

import numpy as np

from gateway.excite.excitation import Series
from gateway.motion.workspace import Workspace

HOME_RAD = np.array([0.0, -0.2, 0.4, 0.0, 0.3, 0.0])


def swing(
    workspace: Workspace, period_s: float = 2.0, periods: int = 3, share: float = 0.8, seed: int = 3, harmonics: int = 3
) -> Series:
    """A series about home that comes to a share of the first limit that it meets."""
    rng = np.random.default_rng(seed)
    order = np.arange(1, harmonics + 1)
    cosine, sine = rng.normal(size=(2, 6, harmonics)) / order
    cosine -= np.outer(cosine @ order**2, order**2) / (order**2 @ order**2)
    sine -= np.outer(sine @ order, order) / (order @ order)
    shape = Series("load", HOME_RAD, cosine, sine, period_s, periods)
    _, speed, acceleration, jerk = shape.at(np.linspace(0.0, period_s, 500))
    limits = (workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
    most = [
        limit / np.abs(values).max(axis=0) for limit, values in zip(limits, (speed, acceleration, jerk), strict=True)
    ]
    scale = share * np.min(most, axis=0)[:, None]
    return Series("load", HOME_RAD, scale * cosine, scale * sine, period_s, periods)
