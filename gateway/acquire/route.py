"""Order the rest poses for short travel, and find checked paths between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from gateway.acquire.roadmap import find_paths, via_points
from gateway.data.rest_pose import RestPose
from gateway.errors import PlanRefused
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace

#: Number of random via points; the larger number is used if a pose is not reachable with the smaller.
VIA_POINTS = (150, 450)


@dataclass(frozen=True, slots=True)
class Leg:
    """Pose and the via points on the path to the start of its approach."""

    pose: RestPose
    via_rad: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Route:
    """Poses in visiting order; `unreachable` holds the poses without a checked path."""

    legs: tuple[Leg, ...]
    unreachable: tuple[RestPose, ...]


def find_route(
    workspace: Workspace,
    poses: Sequence[RestPose],
    start_rad: np.ndarray | None,
    approach_offset_rad: float,
    known_rad: np.ndarray | None = None,
) -> Route:
    """Order the poses for short travel over checked paths.

    A path leads from the end of a visit, which is the pose itself, to the start of the next approach. That start is the
    next pose plus the approach offset on every joint. The path is straight in joint space or over via points.

    Parameters
    ----------
    workspace : Workspace
    poses : sequence of RestPose
    start_rad : array of shape (N,) or None
        Present posture; None = arbitrary.
    approach_offset_rad : float
    known_rad : array of shape (k, N), optional
        Postures with known paths, used in addition to random ones. None: an unreachable pose cannot be replaced, so
        more random postures are drawn.
    """
    if not poses:
        return Route((), ())
    q = np.array([pose.q_rad for pose in poses])
    entries = q + approach_offset_rad
    exits = q if start_rad is None else np.vstack([q, start_rad])
    known = np.empty((0, q.shape[1])) if known_rad is None else known_rad
    counts = VIA_POINTS if known_rad is None or start_rad is not None else VIA_POINTS[:1]
    cost, via = _paths(workspace, exits, entries, (known, counts))
    if start_rad is None:
        apart = ~_joined(cost)
        cost[apart], cost[:, apart] = np.inf, np.inf
    first = np.where(np.isfinite(cost).any(axis=0), 0.0, np.inf) if start_rad is None else cost[-1]
    order = _short_order(cost[: len(q)], first)
    legs, reached, at = [], [], None if start_rad is None else len(q)
    for pose in order:
        if at is not None and not np.isfinite(cost[at, pose]):
            continue
        legs.append(Leg(poses[pose], () if at is None else via[at][pose]))
        reached.append(pose)
        at = pose
    return Route(tuple(legs), tuple(pose for i, pose in enumerate(poses) if i not in reached))


def _joined(cost: np.ndarray) -> np.ndarray:
    """Return the largest set of mutually reachable poses: bool array (n,)."""
    _, of_pose = connected_components(csr_array(np.isfinite(cost)), connection="strong")
    return of_pose == np.argmax(np.bincount(of_pose))


def path_to(workspace: Workspace, start_rad: np.ndarray, end_rad: np.ndarray) -> list[np.ndarray]:
    """Return the points of a checked path including its end: straight where that is free, else over via points.

    Raises
    ------
    PlanRefused
        No such path was found; the message names the violation of the straight path.
    """
    route = find_route(workspace, [RestPose(1, tuple(end_rad.tolist()), "fit")], start_rad, 0.0)
    if not route.legs:
        met = workspace.why_not_path(np.array([start_rad, end_rad]))
        raise PlanRefused(
            f"no path inside the limits leads from {angles(start_rad)} to {angles(end_rad)}: on the straight path,"
            f" {met}, and no detour was found; move there in steps over postures of your choice (servo-gateway move"
            " CELL --to J1,J2,..), or correct the assumed surroundings in the cell file (floor_m, wall, "
            "column_radius_m, link_radius_m, load_size_m)"
        )
    return [*(np.array(point) for point in route.legs[0].via_rad), end_rad]


def _paths(
    workspace: Workspace, exits: np.ndarray, entries: np.ndarray, over: tuple[np.ndarray, tuple[int, ...]]
) -> tuple[np.ndarray, list[list[tuple[tuple[float, ...], ...]]]]:
    """Return the travel times (exits, entries), infinite without a path, and the via points.

    Paths pass known postures (k, N) and random ones; more are drawn while a pose is not reachable.
    """
    known, counts = over
    cost = workspace.travel_time(exits[:, None], entries[None])
    via: list[list[tuple[tuple[float, ...], ...]]] = [[() for _ in entries] for _ in exits]
    pairs = [(a, b) for a in range(len(exits)) for b in range(len(entries)) if a != b]
    clear = workspace.path_clear(exits[[a for a, _ in pairs]], entries[[b for _, b in pairs]])
    blocked = [pair for pair, is_clear in zip(pairs, clear, strict=True) if not is_clear]
    for a, b in blocked:
        cost[a, b] = np.inf
    for count in counts if blocked else ():
        points = np.vstack([known, via_points(workspace, count)])
        if not len(points):
            break
        found = find_paths(workspace, points, exits, entries, blocked)
        for (a, b), path in found.items():
            corners = np.vstack([exits[a], path, entries[b]])
            cost[a, b] = workspace.travel_time(corners[:-1], corners[1:]).sum()
            via[a][b] = tuple(tuple(point.tolist()) for point in path)
        blocked = [pair for pair in blocked if pair not in found]
        if _all_reached(cost):
            break
    return cost, via


def _all_reached(cost: np.ndarray) -> bool:
    """Return True if every pose can be reached from another pose and left towards another pose."""
    others = np.isfinite(cost)
    np.fill_diagonal(others, val=False)
    count = cost.shape[1]
    return bool(others.any(axis=0).all() and (count == 1 or others[:count].any(axis=1).all()))


def _short_order(cost: np.ndarray, first: np.ndarray) -> list[int]:
    """Return a short open tour: nearest neighbour from every start, improved by reversing segments (2-opt)."""
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
