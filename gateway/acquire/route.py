"""Order the rest poses for short travel, and find checked paths between them.

A path around obstacles is the shortest one over random postures whose segments are clear. Segments are checked only
where the current shortest path uses them (lazy probabilistic roadmap; Bohlin and Kavraki, Path planning using lazy PRM,
2000).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from gateway.data.visit import RestPose
from gateway.errors import PlanRefused
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace

#: Number of random via points; the larger number is used if a pose is not reachable with the smaller.
VIA_POINTS = (150, 450)


SEED = 7
#: Number of nearest neighbours of a posture, and of a start or goal.
NEIGHBOURS = 12
NEIGHBOURS_OF_ENDS = 30
#: Number of repeated searches without the segments that were found to be blocked.
ROUNDS = 30
#: Random postures drawn for each requested one.
_DRAWN = 6

#: Pose, and the via points on the path to the start of its approach.
Leg = tuple[RestPose, tuple[tuple[float, ...], ...]]


def clearest_route(
    workspace: Workspace,
    poses: Sequence[RestPose],
    start_rad: np.ndarray | None,
    approach_offset_rad: float,
    known_rad: np.ndarray | None,
) -> tuple[list[Leg], tuple[RestPose, ...]]:
    """Return a route with extra clearance along the paths, else one that is only collision-free; as `find_route`."""
    legs, unreachable = find_route(workspace.with_clearance(), poses, start_rad, approach_offset_rad, known_rad)
    if unreachable:
        return find_route(workspace, poses, start_rad, approach_offset_rad, known_rad)
    return legs, unreachable


def find_route(
    workspace: Workspace,
    poses: Sequence[RestPose],
    start_rad: np.ndarray | None,
    approach_offset_rad: float,
    known_rad: np.ndarray | None = None,
) -> tuple[list[Leg], tuple[RestPose, ...]]:
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

    Returns
    -------
    legs : list of (RestPose, via points)
        In visiting order.
    unreachable : tuple of RestPose
        Poses without a checked path.
    """
    if not poses:
        return [], ()
    q = np.array([pose.q_rad for pose in poses])
    entries = q + approach_offset_rad
    exits = q if start_rad is None else np.vstack([q, start_rad])
    known = np.empty((0, q.shape[1])) if known_rad is None else known_rad
    counts = VIA_POINTS if known_rad is None or start_rad is not None else VIA_POINTS[:1]
    cost, via = _paths(workspace, exits, entries, known, counts)
    if start_rad is None:  # only the largest set of mutually reachable poses
        _, of_pose = connected_components(csr_array(np.isfinite(cost)), connection="strong")
        apart = of_pose != np.argmax(np.bincount(of_pose))
        cost[apart], cost[:, apart] = np.inf, np.inf
    first = np.where(np.isfinite(cost).any(axis=0), 0.0, np.inf) if start_rad is None else cost[-1]
    order = _short_order(cost[: len(q)], first)
    legs: list[Leg] = []
    reached, at = [], None if start_rad is None else len(q)
    for pose in order:
        if at is not None and not np.isfinite(cost[at, pose]):
            continue
        legs.append((poses[pose], () if at is None else via[at][pose]))
        reached.append(pose)
        at = pose
    return legs, tuple(pose for i, pose in enumerate(poses) if i not in reached)


def path_to(workspace: Workspace, start_rad: np.ndarray, end_rad: np.ndarray) -> list[np.ndarray]:
    """Return the points of a checked path including its end: straight where that is free, else over via points.

    Raises
    ------
    PlanRefused
        No such path was found; the message names the violation of the straight path.
    """
    legs, _ = find_route(workspace, [RestPose(1, tuple(end_rad.tolist()), "fit")], start_rad, 0.0)
    if not legs:
        met = workspace.why_not_path(np.array([start_rad, end_rad]))
        raise PlanRefused(
            f"no path inside the limits leads from {angles(start_rad)} to {angles(end_rad)}: on the straight path,"
            f" {met}, and no detour was found; move there in steps over postures of your choice (servo-gateway move"
            " CELL --to J1,J2,..), or correct the assumed surroundings in the cell file (floor_m, wall, "
            "column_radius_m, link_radius_m, load_size_m)"
        )
    return [*(np.array(point) for point in legs[0][1]), end_rad]


def _paths(
    workspace: Workspace, exits: np.ndarray, entries: np.ndarray, known: np.ndarray, counts: Sequence[int]
) -> tuple[np.ndarray, list[list[tuple[tuple[float, ...], ...]]]]:
    """Return the travel times (exits, entries), infinite without a path, and the via points.

    Paths pass known postures (k, N) and random ones; more are drawn while a pose is not reachable.
    """
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
        # enough, if every pose can be reached from another pose and left towards another pose
        others, poses = np.isfinite(cost), len(entries)
        np.fill_diagonal(others, val=False)
        if others.any(axis=0).all() and (poses == 1 or others[:poses].any(axis=1).all()):
            break
    return cost, via


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


def via_points(workspace: Workspace, count: int) -> np.ndarray:
    """Return up to `count` feasible postures (n, N); the middle of the joint range comes first."""
    random = np.random.default_rng(SEED)
    lower, upper = workspace.lower_rad, workspace.upper_rad
    q_rad = np.vstack([(lower + upper) / 2, random.uniform(lower, upper, (_DRAWN * count, workspace.robot.axes))])
    return q_rad[workspace.feasible(q_rad)][:count]


def find_paths(
    workspace: Workspace,
    points: np.ndarray,
    begins: np.ndarray,
    ends: np.ndarray,
    wanted: Sequence[tuple[int, int]],
) -> Mapping[tuple[int, int], np.ndarray]:
    """Return the via points (k, N) from start to goal, for every requested pair with a path.

    Parameters
    ----------
    workspace : Workspace
    points : array of shape (p, N)
    begins, ends : arrays of shape (b, N), (e, N)
    wanted : sequence of (row of begins, row of ends)
    """
    nodes = np.vstack([points, begins, ends])
    count, total = len(points), len(nodes)
    to_points_s = workspace.travel_time(nodes[:, None], points[None])
    joined = np.zeros((total, total), dtype=bool)
    for row, nearest in enumerate(np.argsort(to_points_s, axis=1)):
        joined[row, nearest[: NEIGHBOURS + 1 if row < count else NEIGHBOURS_OF_ENDS]] = True
    joined |= joined.T
    np.fill_diagonal(joined, False)
    full_s = np.zeros((total, total))
    full_s[:, :count] = to_points_s
    full_s[:count] = np.maximum(full_s[:count], full_s[:, :count].T)
    time_s = np.where(joined, full_s, 0.0)  # of the segments to try, 0 for all others
    checked = np.zeros(time_s.shape, dtype=bool)
    sources = sorted({a for a, _ in wanted})
    found: dict[tuple[int, int], np.ndarray] = {}
    left = list(wanted)
    for _ in range(ROUNDS):
        _, before = dijkstra(csr_array(time_s), indices=[len(points) + a for a in sources], return_predecessors=True)
        paths = {}
        for a, b in left:
            path = _path(before[sources.index(a)], len(points) + a, len(points) + len(begins) + b)
            if path:
                paths[a, b] = path
        doubtful = sorted(
            {
                (min(p), max(p))
                for path in paths.values()
                for p in zip(path[:-1], path[1:], strict=True)
                if not checked[p]
            }
        )
        if doubtful:
            from_, to = np.array(doubtful).T
            clear = workspace.path_clear(nodes[from_], nodes[to])
            checked[from_[clear], to[clear]] = checked[to[clear], from_[clear]] = True
            time_s[from_[~clear], to[~clear]] = time_s[to[~clear], from_[~clear]] = 0.0
        for pair, path in paths.items():
            if all(checked[piece] for piece in zip(path[:-1], path[1:], strict=True)):
                found[pair] = nodes[path[1:-1]]
        left = [pair for pair in paths if pair not in found]
        if not left:
            break
    return found


def _path(before: np.ndarray, begin: int, end: int) -> list[int]:
    """Return the nodes from start to goal from the predecessor of each node; empty without a path."""
    path = [end]
    while path[-1] != begin:
        if before[path[-1]] < 0:
            return []
        path.append(int(before[path[-1]]))
    return path[::-1]
