"""Choose the learning points along the path (CN104379308 embodiment 8, fig. 16).

Every feature gives a value per command; divided by its threshold it is a score, and commands whose score reaches 1 are
candidates at its local maxima (all of a level stretch). The best ones are accepted first, with a minimum distance in
time and arc length. Position and time confine the other features under "all". Start and end are always included. Old
points stay (union): a well learned region has no force any more, and without its points the force would return. Taking
the new points alone (replace) is the patent's text, kept for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats, log_rotation
from gateway.pair.transform_function import TransformFunction, function_of_knots

FeatureKind = Literal[
    "force",
    "force_rate",
    "moment",
    "correction",
    "correction_rate",
    "change",
    "speed",
    "acceleration",
    "turn_rate",
    "position",
    "time",
]
Combination = Literal["any", "all", "sum"]


@dataclass(frozen=True, slots=True)
class Feature:
    """Condition by which a command is chosen as a learning point.

    Attributes
    ----------
    kind : what is looked at: acting force [N] or moment [Nm] (distance error [m], [rad] with distance sensors),
        correction [m, turning by the path's lever], their rates [1/s], `change` of the force since the block of cycles
        before, speed [m/s] and acceleration [m/s2] of the command, its turning rate [rad/s], its position inside boxes,
        the time of its use inside windows
    threshold : value from which a command is a candidate; not used for position and time
    boxes : (lower (3), upper (3)) in the master's base [m], for "position"
    windows_s : (from, to), for "time"
    """

    kind: FeatureKind
    threshold: float = 1.0
    boxes: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()
    windows_s: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in get_args(FeatureKind):
            raise ConfigError(f"learning points: feature '{self.kind}' is none of {', '.join(get_args(FeatureKind))}")
        if not self.threshold > 0.0:
            raise ConfigError(f"learning points: threshold of '{self.kind}' must be positive, got {self.threshold}")
        needed = {"position": self.boxes, "time": self.windows_s}.get(self.kind)
        if needed is not None and not needed:
            raise ConfigError(
                f"learning points: feature '{self.kind}' needs {'boxes' if self.kind[0] == 'p' else 'windows_s'}"
            )


@dataclass(frozen=True, slots=True)
class Selection:
    """Conditions and limits of the choice of learning points."""

    features: tuple[Feature, ...]
    combination: Combination = "any"
    keep: Literal["union", "replace"] = "union"
    largest_count: int = 20
    apart_s: float = 0.03
    apart_m: float = 0.005
    #: A point is added where the function without it would leave more than this force, 0 = nowhere; largest number of
    #: points.
    gain_n: float = 0.0
    refined_count: int = 60
    prune_m: float = 0.02e-3
    prune_rad: float = 0.05e-3

    def __post_init__(self) -> None:
        if not self.features or self.largest_count < 2:
            raise ConfigError("learning points: at least one feature and two points are needed")


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Data of one block of cycles, per command: force and correction (M, 6), force of the block before."""

    force: Floats
    correction: Floats
    force_before: Floats


def score(selection: Selection, record: Record, path: PairPath) -> Floats:
    """Return the score (M,) of every command; commands with 1 or more are candidates."""
    each = np.array([_value(feature, record, path) / feature.threshold for feature in selection.features])
    if selection.combination == "any":
        return each.max(axis=0)
    if selection.combination == "sum":
        return each.sum(axis=0)
    confines = np.array([feature.kind in ("position", "time") for feature in selection.features])
    if confines.all():
        return each.min(axis=0)
    return each[~confines].min(axis=0) * each[confines].all(axis=0)


def select(selection: Selection, scores: ArrayLike, path: PairPath, present: ArrayLike) -> np.ndarray:
    """Indices of the learning points.

    Parameters
    ----------
    selection : Selection
    scores : array of shape (M,)
    path : PairPath
    present : array of int
        Indices of the present points; kept with "union".

    Returns
    -------
    array of int, rising, 0 and M - 1 among them, at most `largest_count` (present ones are never dropped)
    """
    value = np.asarray(scores, dtype=float)
    chosen = [0, len(path) - 1]
    if selection.keep == "union":
        chosen += [int(index) for index in np.asarray(present) if 0 < index < len(path) - 1]
    inner = value[1:-1]
    peak = (inner >= 1.0) & (inner >= value[:-2]) & (inner >= value[2:])
    candidates = np.flatnonzero(peak) + 1
    for index in candidates[np.argsort(-value[candidates], kind="stable")]:
        if len(chosen) >= selection.largest_count:
            break
        others = np.array(chosen)
        far_in_time = np.abs(others - index) * path.dt_s >= selection.apart_s
        far_along_path = np.abs(path.s_m[others] - path.s_m[index]) >= selection.apart_m
        if np.all(far_in_time & far_along_path):
            chosen.append(int(index))
    return np.unique(chosen)


def refine(
    selection: Selection, wanted: Floats, path: PairPath, present: np.ndarray, stiffness: ArrayLike
) -> np.ndarray:
    """Indices of the learning points with those whose absence would cost most, best one first.

    Parameters
    ----------
    selection : Selection
    wanted : array of shape (M, 4, 4)
        Demanded relation of every command.
    path : PairPath
    present : array of int, rising
    stiffness : of the chain, straight [N/m] and turned [Nm/rad]

    Returns
    -------
    array of int, rising, at most `refined_count`; with a minimum distance in time and arc length
    """
    chosen = np.unique(present)
    straight, turned = np.asarray(stiffness, dtype=float)
    while len(chosen) < selection.refined_count:
        near = np.abs(np.arange(len(path))[:, None] - chosen).min(axis=1) * path.dt_s < selection.apart_s
        near |= np.abs(path.s_m[:, None] - path.s_m[chosen]).min(axis=1) < selection.apart_m
        arc_m, first = np.unique(path.s_m[chosen], return_index=True)
        there = function_of_knots(arc_m, wanted[chosen[first]]).many(path.s_m)
        away_m = np.linalg.norm(there[:, :3, 3] - wanted[:, :3, 3], axis=1)
        turn = log_rotation(np.swapaxes(there[:, :3, :3], 1, 2) @ wanted[:, :3, :3])
        cost_n = np.hypot(straight * away_m, turned * np.linalg.norm(turn, axis=1) / path.rho_m)
        cost_n[near] = 0.0
        best = int(np.argmax(cost_n))
        if cost_n[best] < selection.gain_n:
            break
        chosen = np.unique(np.append(chosen, best))
    return chosen


def prune(selection: Selection, function: TransformFunction) -> TransformFunction:
    """Remove knots that change the function by less than the tolerance; first and last stay.

    A knot is removed when the straight line between its neighbours passes within `prune_m` and `prune_rad` of it.
    """
    s_m, knots = function.s_m, function.knots
    kept = list(range(len(s_m)))
    position = 1
    while position < len(kept) - 1:
        before, here, after = kept[position - 1], kept[position], kept[position + 1]
        bridge = function_of_knots(s_m[[before, after]], knots[[before, after]]).at(float(s_m[here]))
        away_m = float(np.linalg.norm(bridge[:3, 3] - knots[here, :3, 3]))
        away_rad = float(np.linalg.norm(log_rotation(bridge[:3, :3].T @ knots[here, :3, :3])))
        if away_m < selection.prune_m and away_rad < selection.prune_rad:
            kept.pop(position)
        else:
            position += 1
    return function_of_knots(s_m[kept], knots[kept])


def _value(feature: Feature, record: Record, path: PairPath) -> Floats:
    kind, dt_s = feature.kind, path.dt_s
    if kind in ("force", "moment", "force_rate", "change"):
        columns = slice(3, 6) if kind == "moment" else slice(0, 3)
        force = record.force[:, columns]
        if kind == "force_rate":
            force = np.gradient(force, dt_s, axis=0)
        if kind == "change":
            force = force - record.force_before[:, columns]
        return np.linalg.norm(force, axis=1)
    if kind in ("correction", "correction_rate"):
        corrections = record.correction if kind == "correction" else np.gradient(record.correction, dt_s, axis=0)
        return np.hypot(
            np.linalg.norm(corrections[:, :3], axis=1), path.rho_m * np.linalg.norm(corrections[:, 3:], axis=1)
        )
    place = path.commands[:, :3, 3]
    if feature.kind == "position":
        inside = [np.all((place >= lower) & (place <= upper), axis=1) for lower, upper in feature.boxes]
        return feature.threshold * np.any(inside, axis=0).astype(float)
    if feature.kind == "time":
        time = np.arange(len(path)) * path.dt_s
        inside = [(time >= start) & (time <= end) for start, end in feature.windows_s]
        return feature.threshold * np.any(inside, axis=0).astype(float)
    if feature.kind == "turn_rate":
        turn = path.commands[:, :3, :3]
        step = log_rotation(turn[1:] @ np.swapaxes(turn[:-1], 1, 2))
        return np.linalg.norm(np.append(step, step[-1:], axis=0), axis=1) / path.dt_s
    speed = np.gradient(place, path.dt_s, axis=0)
    if feature.kind == "acceleration":
        speed = np.gradient(speed, path.dt_s, axis=0)
    return np.linalg.norm(speed, axis=1)
