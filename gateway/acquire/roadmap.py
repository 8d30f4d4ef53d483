"""Ways around what stands between two postures: the shortest over random postures whose straight pieces are clear.

Pieces are checked only where the shortest way so far leads over them (lazy probabilistic roadmap; Bohlin and Kavraki,
Path planning using lazy PRM, 2000).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from gateway.motion.workspace import Workspace

SEED = 7
#: Nearest postures that a posture is joined to, and that a begin or an end is joined to.
NEIGHBOURS = 12
NEIGHBOURS_OF_ENDS = 30
#: How often ways are looked for again without the pieces that were found to be blocked.
ROUNDS = 30
#: Random postures that are drawn for each that is asked for.
_DRAWN = 6


def via_points(workspace: Workspace, count: int) -> np.ndarray:
    """Up to `count` feasible postures (n, N) of the joint range, its middle first."""
    random = np.random.default_rng(SEED)
    lower, upper = workspace.lower_rad, workspace.upper_rad
    q_rad = np.vstack([(lower + upper) / 2, random.uniform(lower, upper, (_DRAWN * count, workspace.robot.axes))])
    return q_rad[workspace.feasible(q_rad)][:count]


def find_ways(
    workspace: Workspace,
    points: np.ndarray,
    begins: np.ndarray,
    ends: np.ndarray,
    wanted: Sequence[tuple[int, int]],
) -> Mapping[tuple[int, int], np.ndarray]:
    """Postures (k, N) to pass from a begin to an end, for every wanted pair that a way was found for.

    Parameters
    ----------
    workspace : Workspace
    points : array of shape (p, N)
    begins, ends : arrays of shape (b, N), (e, N)
    wanted : sequence of (row of begins, row of ends)
    """
    nodes = np.vstack([points, begins, ends])
    time_s = _pieces(workspace, points, begins, ends)
    sure = np.zeros(time_s.shape, dtype=bool)
    sources = sorted({a for a, _ in wanted})
    found: dict[tuple[int, int], np.ndarray] = {}
    left = list(wanted)
    for _ in range(ROUNDS):
        _, before = dijkstra(csr_array(time_s), indices=[len(points) + a for a in sources], return_predecessors=True)
        ways = {}
        for a, b in left:
            way = _way(before[sources.index(a)], len(points) + a, len(points) + len(begins) + b)
            if way:
                ways[a, b] = way
        doubtful = sorted(
            {(min(p), max(p)) for way in ways.values() for p in zip(way[:-1], way[1:], strict=True) if not sure[p]}
        )
        if doubtful:
            from_, to = np.array(doubtful).T
            clear = workspace.path_clear(nodes[from_], nodes[to])
            sure[from_[clear], to[clear]] = sure[to[clear], from_[clear]] = True
            time_s[from_[~clear], to[~clear]] = time_s[to[~clear], from_[~clear]] = 0.0
        for pair, way in ways.items():
            if all(sure[piece] for piece in zip(way[:-1], way[1:], strict=True)):
                found[pair] = nodes[way[1:-1]]
        left = [pair for pair in ways if pair not in found]
        if not left:
            break
    return found


def _pieces(workspace: Workspace, points: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Travel times (n, n) of the pieces that are tried, 0 for all others."""
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


def _way(before: np.ndarray, begin: int, end: int) -> list[int]:
    """Nodes from begin to end by the node before each; empty where there is no way."""
    way = [end]
    while way[-1] != begin:
        if before[way[-1]] < 0:
            return []
        way.append(int(before[way[-1]]))
    return way[::-1]
