"""Order of the rest poses and the paths between them: every path is checked, travel is short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.data.rest_pose import RestPose
from gateway.errors import PlanRefused
from gateway.motion.places import angles
from gateway.motion.workspace import Workspace

VIA_SEED = 7
VIA_POINTS = 200
VIA_TRIED = 40
#: Points that are checked together.
VIA_AT_ONCE = 8


@dataclass(frozen=True, slots=True)
class Leg:
    """One pose and the points to pass on the way to the start of its approach."""

    pose: RestPose
    via_rad: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Route:
    """Poses in the order of visiting; `unreachable` have no checked path."""

    legs: tuple[Leg, ...]
    unreachable: tuple[RestPose, ...]


def find_route(
    workspace: Workspace, poses: Sequence[RestPose], start_rad: np.ndarray | None, approach_offset_rad: float
) -> Route:
    """Order the poses for short travel over paths that stay feasible.

    A path leads from where the last visit ends (the pose itself) to where the next begins (the pose plus the approach
    offset on every joint), straight in joint space or over one point in between.

    Parameters
    ----------
    workspace : Workspace
    poses : sequence of RestPose
    start_rad : array of shape (N,) or None
        Where the arm stands; None = anywhere.
    approach_offset_rad : float
    """
    if not poses:
        return Route((), ())
    q = np.array([pose.q_rad for pose in poses])
    entries = q + approach_offset_rad
    exits = q if start_rad is None else np.vstack([q, start_rad])
    cost, via = _paths(workspace, exits, entries)
    first = np.zeros(len(q)) if start_rad is None else cost[-1]
    order = _short_order(cost[: len(q)], first)
    legs, reached, at = [], [], None if start_rad is None else len(q)
    for pose in order:
        if at is not None and not np.isfinite(cost[at, pose]):
            continue
        legs.append(Leg(poses[pose], () if at is None else via[at][pose]))
        reached.append(pose)
        at = pose
    return Route(tuple(legs), tuple(pose for i, pose in enumerate(poses) if i not in reached))


def way_to(workspace: Workspace, start_rad: np.ndarray, end_rad: np.ndarray) -> list[np.ndarray]:
    """Points of a checked way, the end included: straight where that is free, else over one point in between.

    Raises
    ------
    PlanRefused
        No such way was found; says what the straight one meets.
    """
    route = find_route(workspace, [RestPose(1, tuple(end_rad.tolist()), "fit")], start_rad, 0.0)
    if not route.legs:
        met = workspace.why_not_path(np.array([start_rad, end_rad]))
        raise PlanRefused(
            f"no way that keeps the limits leads from {angles(start_rad)} to {angles(end_rad)}: straight there, {met}, "
            "and no posture was found over which it would be free; go there in steps, by postures of your own choice "
            "(servo-gateway move CELL --to J1,J2,..), or open the keep_out boxes"
        )
    return [*(np.array(point) for point in route.legs[0].via_rad), end_rad]


def _paths(
    workspace: Workspace, exits: np.ndarray, entries: np.ndarray
) -> tuple[np.ndarray, list[list[tuple[tuple[float, ...], ...]]]]:
    """Travel time (exits, entries), infinite where no path was found, and the points to pass."""
    cost = workspace.travel_time(exits[:, None], entries[None])
    via: list[list[tuple[tuple[float, ...], ...]]] = [[() for _ in entries] for _ in exits]
    pairs = [(a, b) for a in range(len(exits)) for b in range(len(entries)) if a != b]
    clear = workspace.path_clear(exits[[a for a, _ in pairs]], entries[[b for _, b in pairs]])
    points = _via_points(workspace) if not clear.all() else np.empty((0, workspace.robot.axes))
    for (a, b), is_clear in zip(pairs, clear, strict=True):
        if not is_clear:
            point = _one_point_between(workspace, exits[a], entries[b], points)
            cost[a, b] = np.inf
            if point is not None:
                cost[a, b] = workspace.travel_time(np.array([exits[a], point]), np.array([point, entries[b]])).sum()
                via[a][b] = (tuple(point.tolist()),)
    return cost, via


def _via_points(workspace: Workspace) -> np.ndarray:
    random = np.random.default_rng(VIA_SEED)
    q = random.uniform(workspace.lower_rad, workspace.upper_rad, (4 * VIA_POINTS, workspace.robot.axes))
    q = np.vstack([(workspace.lower_rad + workspace.upper_rad) / 2, q])
    return q[workspace.feasible(q)][:VIA_POINTS]


def _one_point_between(
    workspace: Workspace, start_rad: np.ndarray, end_rad: np.ndarray, points: np.ndarray
) -> np.ndarray | None:
    """The point over which both halves are clear and the way is shortest."""
    if not len(points):
        return None
    time_s = workspace.travel_time(start_rad, points) + workspace.travel_time(points, end_rad)
    nearest = points[np.argsort(time_s)[:VIA_TRIED]]
    for begin in range(0, len(nearest), VIA_AT_ONCE):
        tried = nearest[begin : begin + VIA_AT_ONCE]
        begins = np.vstack([np.broadcast_to(start_rad, tried.shape), tried])
        ends = np.vstack([tried, np.broadcast_to(end_rad, tried.shape)])
        clear = workspace.path_clear(begins, ends).reshape(2, -1).all(axis=0)
        if clear.any():
            return tried[int(np.argmax(clear))]
    return None


def _short_order(cost: np.ndarray, first: np.ndarray) -> list[int]:
    """Open tour: nearest neighbour from every begin, improved by reversing parts (2-opt)."""
    count = len(first)
    finite = np.concatenate([cost[np.isfinite(cost)], first[np.isfinite(first)]])
    large = 1e3 * (finite.max() if len(finite) else 1.0)
    cost, first = np.where(np.isfinite(cost), cost, large), np.where(np.isfinite(first), first, large)
    tours = [_nearest(cost, begin) for begin in range(count)]
    best = min(tours, key=lambda tour: _length(cost, first, tour))
    improved = True
    while improved:
        improved = False
        for i in range(count):
            for j in range(i + 2, count + 1):
                other = best[:i] + best[i:j][::-1] + best[j:]
                if _length(cost, first, other) < _length(cost, first, best) - 1e-9:
                    best, improved = other, True
    return best


def _nearest(cost: np.ndarray, begin: int) -> list[int]:
    tour, left = [begin], set(range(len(cost))) - {begin}
    while left:
        following = min(left, key=lambda node: cost[tour[-1], node])
        tour.append(following)
        left.remove(following)
    return tour


def _length(cost: np.ndarray, first: np.ndarray, tour: list[int]) -> float:
    return float(first[tour[0]] + cost[tour[:-1], tour[1:]].sum())
