"""What happens to commands between the taught points and the servo, and how the pair copes with it.

*Passing near* ([0128]): a controller that blends corners never runs through the taught points. The path of the pair is
therefore made of the commands as they are streamed, after blending; functions that are learned on the run belong to
them by themselves.

*Filtered commands* ([0129]): if the master's controller smooths its commands before the servo, its gripper is not where
the command says. Either the master's present position is what is learned from (source "master_measured") and the
slave's commands go out unfiltered; or a slave whose controller filters as well gets commands whose filtered version is
what is wanted.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats, exp_rotation, log_rotation


def pass_near(poses: ArrayLike, half_width: int) -> Floats:
    """Streamed commands (M, 4, 4) with corners rounded by a symmetric mean over `2 half_width + 1` of them.

    Start and end are kept. Rotations are averaged as rotation vectors about the middle one.
    """
    given = np.asarray(poses, dtype=float)
    result = given.copy()
    for m in range(1, len(given) - 1):
        width = min(half_width, m, len(given) - 1 - m)
        window = given[m - width : m + width + 1]
        middle = given[m, :3, :3]
        result[m, :3, 3] = window[:, :3, 3].mean(axis=0)
        result[m, :3, :3] = middle @ exp_rotation(log_rotation(middle.T @ window[:, :3, :3]).mean(axis=0))
    return result


def _share(time_constant_s: float, dt_s: float) -> float:
    if not (time_constant_s >= 0.0 and dt_s > 0.0):
        raise ConfigError(f"command filter: time constant must not be negative, got {time_constant_s} s")
    return 1.0 if time_constant_s == 0.0 else 1.0 - math.exp(-dt_s / time_constant_s)


def _moved(start: Floats, target: Floats, share: float) -> Floats:
    """Pose that lies a share of the way from one pose to another, straight and about a fixed axis."""
    result = start.copy()
    result[:3, 3] += share * (target[:3, 3] - start[:3, 3])
    result[:3, :3] = start[:3, :3] @ exp_rotation(share * log_rotation(start[:3, :3].T @ target[:3, :3]))
    return result


def low_pass(poses: ArrayLike, time_constant_s: float, dt_s: float) -> Floats:
    """Commands (M, 4, 4) after a first-order low-pass that starts at rest on the first one."""
    given, share = np.asarray(poses, dtype=float), _share(time_constant_s, dt_s)
    result = given.copy()
    for m in range(1, len(given)):
        result[m] = _moved(result[m - 1], given[m], share)
    return result


def inverse_low_pass(poses: ArrayLike, time_constant_s: float, dt_s: float) -> Floats:
    """Commands (M, 4, 4) that `low_pass` turns into the given ones."""
    given, share = np.asarray(poses, dtype=float), _share(time_constant_s, dt_s)
    result = given.copy()
    for m in range(1, len(given)):
        result[m] = _moved(given[m - 1], given[m], 1.0 / share)
    return result
