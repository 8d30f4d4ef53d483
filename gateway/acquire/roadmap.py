"""Plan paths around obstacles between two postures: the shortest path over random postures whose segments are clear.

Segments are checked only where the current shortest path uses them (lazy probabilistic roadmap; Bohlin and Kavraki,
Path planning using lazy PRM, 2000).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from gateway.motion.workspace import Workspace

SEED = 7
#: Number of nearest neighbours of a posture, and of a start or goal.
NEIGHBOURS = 12
NEIGHBOURS_OF_ENDS = 30
#: Number of repeated searches without the segments that were found to be blocked.
ROUNDS = 30
#: Random postures drawn for each requested one.
_DRAWN = 6


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
    time_s = _pieces(workspace, points, begins, ends)
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


def _pieces(workspace: Workspace, points: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the travel times (n, n) of the segments to try, 0 for all others."""
    count, total = len(points), len(points) + len(begins) + len(ends)
    joined = np.zeros((total, total), dtype=bool)
    every = np.vstack([points, begins, ends])
    time_s = workspace.travel_time(every[:, None], points[None])
    nearest = np.argsort(time_s, axis=1)
    for row in range(total):
        own = NEIGHBOURS + 1 if row < count else NEIGHBOURS_OF_ENDS
        joined[row, nearest[row, :own]] = True
    joined |= joined.T
    np.fill_diagonal(joined, False)
    full = np.zeros((total, total))
    full[:, :count] = time_s
    full[:count] = np.maximum(full[:count], full[:, :count].T)
    return np.where(joined, full, 0.0)


def _path(before: np.ndarray, begin: int, end: int) -> list[int]:
    """Return the nodes from start to goal from the predecessor of each node; empty without a path."""
    path = [end]
    while path[-1] != begin:
        if before[path[-1]] < 0:
            return []
        path.append(int(before[path[-1]]))
    return path[::-1]
