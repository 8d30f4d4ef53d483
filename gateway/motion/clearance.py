"""Collision checks of an arm: pairs of bodies, their distances, and proof that a path is collision-free.

The path is proven clear, not sampled. Between two postures, a point of a body moves relative to another body by at most
the joint steps times the levers. A segment is therefore clear if the sum of the distances at its ends exceeds that
bound; any other segment is halved (conservative advancement, Mirtich 1996, section 2.3).

Distances are computed between the capsules around the bodies, all at once. The distance of the bodies themselves (FCL)
is computed only where the capsules do not decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.model.robot import Robot, reach_m
from gateway.motion.body import BASE, LOAD, Body, base_and_link_frames, body_of_parts, moving_parts
from gateway.motion.convex_distance import TOLERANCE_M, Exact, segment_box_distance, segment_segment_distance
from gateway.motion.surroundings import Plane, surroundings_of

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

#: A segment with a smaller relative motion of all bodies is not halved again [m]. It is blocked unless it is
#: proven clear, so that a path that passes an obstacle closer than half of this is refused.
PATH_RESOLUTION_M = 0.002
#: Capsule distance above which the exact distance is not computed [m]: halving the segment is cheaper.
CLOSE_M = 0.03
#: Additional clearance of planned paths [m], for pairs that can be farther apart than this.
PLANNING_CLEARANCE_M = 0.005
#: Random postures at which pairs are tested for permanent contact.
SAMPLES = 200
#: Share of those postures with contact above which a pair with an assumed shape is not checked.
ALWAYS = 0.95
_SEED = 11
#: Number of rows per batch.
_BLOCK = 200_000
#: Kinds of the second object of a pair.
SOLID, BOX, PLANE = range(3)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs of bodies whose distance is checked: a table of p rows.

    Attributes
    ----------
    kind : int array of shape (p,)
        Kind of the second object: body, box or plane.
    first, other : int arrays of shape (p,)
        Index of the moving body; index of the second body, box or plane.
    lever_m : array of shape (p, N)
        Largest distance of a point of the moving body from each joint axis between the two.
    clearance_m : array of shape (p,)
        Clearance that is subtracted from each distance.
    """

    kind: Rows
    first: Rows
    other: Rows
    lever_m: Floats
    clearance_m: Floats

    def only(self, rows: NDArray[np.bool_]) -> Pairs:
        """Return a selection of the rows."""
        return Pairs(self.kind[rows], self.first[rows], self.other[rows], self.lever_m[rows], self.clearance_m[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Bodies of an arm, its surroundings, and the pairs to keep apart.

    Attributes
    ----------
    robot : Robot
    body : Body
    boxes_m : array of shape (b, 2, 3)
        Lower and upper corners.
    planes : tuple of Plane
    pairs : Pairs
    narrow : bool array of shape (p,)
        Pairs whose distance never exceeds `PLANNING_CLEARANCE_M`.
    unchecked : tuple of str
        Pairs that are not checked because they touch at all joint positions.
    exact : Exact
        Distances of the bodies themselves.
    """

    robot: Robot
    body: Body
    boxes_m: Floats
    planes: tuple[Plane, ...]
    pairs: Pairs
    narrow: NDArray[np.bool_]
    unchecked: tuple[str, ...]
    exact: Exact

    def with_clearance(self) -> Space:
        """Return a copy that keeps `PLANNING_CLEARANCE_M` between all pairs that can be that far apart."""
        return replace(self, pairs=replace(self.pairs, clearance_m=np.where(self.narrow, 0.0, PLANNING_CLEARANCE_M)))

    def gaps_m(self, q_rad: Floats, posture: Rows, pair: Rows, enough_m: Floats) -> Floats:
        """Return the distances (m,) [m] of pairs at postures, less the clearance; 0 or less at contact.

        Parameters
        ----------
        q_rad : array of shape (n, N)
        posture, pair : int arrays of shape (m,)
            Rows of `q_rad` and of the table of pairs.
        enough_m : array of shape (m,)
            If a lower bound exceeds this, or `CLOSE_M`, the bound is returned.
        """
        frames = base_and_link_frames(self.robot, q_rad)
        segments = self.body.segments_m(frames)
        out = np.empty(len(pair))
        for kind, distance in ((SOLID, self._solids), (BOX, self._boxes), (PLANE, self._planes)):
            rows = np.flatnonzero(self.pairs.kind[pair] == kind)
            if len(rows):
                first, other = self.pairs.first[pair[rows]], self.pairs.other[pair[rows]]
                clearance = self.pairs.clearance_m[pair[rows]]
                enough = enough_m[rows] + clearance
                out[rows] = distance(frames, segments, posture[rows], first, other, enough) - clearance
        return out

    # Distances (m,) of one kind of pairs, or lower bounds above `enough_m`, at frames (n, N + 1, 4, 4) and segments
    # (n, k, 2, 3) of postures.

    def _solids(
        self, frames: Floats, segments: Floats, posture: Rows, first: Rows, other: Rows, enough_m: Floats
    ) -> Floats:
        one, two = segments[posture, first], segments[posture, other]
        thick = self.body.radius_m[first] + self.body.radius_m[other]
        half = (_length(one) + _length(two)) / 2
        found = np.linalg.norm(one.mean(axis=1) - two.mean(axis=1), axis=1) - half - thick
        near = np.flatnonzero(found <= enough_m)
        found[near] = segment_segment_distance(one[near], two[near]) - thick[near]
        plain = self.exact.plain[first] & self.exact.plain[other]
        for row in np.flatnonzero((found <= np.minimum(enough_m, CLOSE_M)) & ~plain):
            found[row] = self.exact.solids_m(frames[posture[row]], first[row], other[row])
        return found

    def _boxes(
        self, frames: Floats, segments: Floats, posture: Rows, first: Rows, other: Rows, enough_m: Floats
    ) -> Floats:
        low, high = self.boxes_m[other, 0] + TOLERANCE_M, self.boxes_m[other, 1] - TOLERANCE_M
        ends, thick = segments[posture, first], self.body.radius_m[first]
        middle = ends.mean(axis=1)
        found = np.linalg.norm(middle - np.clip(middle, low, high), axis=1) - _length(ends) / 2 - thick
        near = np.flatnonzero(found <= enough_m)
        found[near] = segment_box_distance(ends[near, 0], ends[near, 1], low[near], high[near]) - thick[near]
        for row in np.flatnonzero((found <= np.minimum(enough_m, CLOSE_M)) & ~self.exact.plain[first]):
            found[row] = self.exact.box_m(frames[posture[row]], first[row], other[row])
        return found

    def _planes(
        self, frames: Floats, segments: Floats, posture: Rows, first: Rows, other: Rows, enough_m: Floats
    ) -> Floats:
        normals = np.array([plane.normal for plane in self.planes])[other]
        heights = np.array([plane.height_m for plane in self.planes])[other]
        lowest = np.einsum("mej,mj->me", segments[posture, first], normals).min(axis=1)
        found = lowest - heights - self.body.radius_m[first]
        near = (found <= enough_m) & ~self.exact.plain[first]
        for solid in np.unique(first[near]):
            rows = np.flatnonzero(near & (first == solid))
            frame = frames[posture[rows], self.body.link[solid] + 1]
            body = self.body.solids[solid]
            turned = np.einsum("mji,mj->mi", frame[:, :3, :3], normals[rows])
            origin = np.einsum("mj,mj->m", frame[:, :3, 3], normals[rows])
            found[rows] = (body.points_m @ turned.T).min(axis=0) + origin - heights[rows] - body.radius_m
        return found

    def touching(self, q_rad: Floats) -> NDArray[np.bool_]:
        """Return True for each posture (n, N) with any contact: bool array of shape (n,)."""
        found = np.zeros(len(q_rad), dtype=bool)
        count = max(len(self.pairs.kind), 1)
        for begin in range(0, len(q_rad), max(_BLOCK // count, 1)):
            part = q_rad[begin : begin + max(_BLOCK // count, 1)]
            found[begin : begin + len(part)] = (self._all_gaps(part) <= 0.0).any(axis=1)
        return found

    def _all_gaps(self, q_rad: Floats) -> Floats:
        """Return the distances (n, p); lower bounds where they are above 0."""
        count = len(self.pairs.kind)
        posture, pair = np.repeat(np.arange(len(q_rad)), count), np.tile(np.arange(count), len(q_rad))
        return self.gaps_m(q_rad, posture, pair, np.zeros(len(pair))).reshape(len(q_rad), count)

    def touches(self, q_rad: Floats) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        """Return each contact as text with the postures (n, N) at which it occurs: bool arrays of shape (n,)."""
        touching = self._all_gaps(q_rad) <= 0.0
        words = [self.name_of(row, with_sources=True) for row in range(len(self.pairs.kind))]
        for each in dict.fromkeys(words):
            of_pair = [row for row, other in enumerate(words) if other == each]
            yield each, np.asarray(np.any(touching[:, of_pair], axis=1), dtype=bool)

    def name_of(self, pair: int, *, with_sources: bool = False) -> str:
        """Return the names of a pair, such as "link 6 and link 4", or its contact with the source of each size."""
        kind, other = self.pairs.kind[pair], int(self.pairs.other[pair])
        part = self.body.parts[self.body.part[self.pairs.first[pair]]]
        if kind == BOX:
            box = f"keep_out box {other + 1}"
            return f"{part.name} in {box} ({part.source})" if with_sources else f"{part.name} and {box}"
        second = self.planes[other] if kind == PLANE else self.body.parts[self.body.part[other]]
        name = second.name if second.name.startswith("link ") else f"the {second.name}"
        verb = "in" if kind == PLANE else "touches"
        if with_sources:
            return f"{part.name} ({part.source}) {verb} {name} ({second.source})"
        return f"{part.name} and {name}"

    def blocked_at(self, start_rad: Floats, end_rad: Floats) -> Floats:
        """Return the share of the path at which a straight joint motion collides or is not proven clear; NaN = clear.

        Parameters
        ----------
        start_rad, end_rad : arrays of shape (n, N)

        Returns
        -------
        array of shape (n,)
            A position on the path that is not clear; not always the first.
        """
        found = np.full(len(start_rad), np.nan)
        block = max(_BLOCK // max(len(self.pairs.kind), 1), 1)
        for begin in range(0, len(start_rad), block):
            rows = slice(begin, begin + block)
            found[rows] = self._blocked(start_rad[rows], end_rad[rows])
        return found

    def _blocked(self, start_rad: Floats, end_rad: Floats) -> Floats:
        found = np.full(len(start_rad), np.nan)
        turn = end_rad - start_rad
        path = np.abs(turn) @ self.pairs.lever_m.T
        segment, pair = (index.ravel() for index in np.indices(path.shape))
        low, high = np.zeros(len(segment)), np.ones(len(segment))

        def gaps(todo: tuple[Rows, Rows], at: Floats, enough_m: Floats) -> Floats:
            places, posture = np.unique(todo[0] + 0.5 * at, return_inverse=True)
            segment = places.astype(np.intp)
            q_rad = start_rad[segment] + (2.0 * (places - segment))[:, None] * turn[segment]
            return self.gaps_m(q_rad, posture, todo[1], enough_m)

        step = path[segment, pair]
        before, after = gaps((segment, pair), low, step / 2), gaps((segment, pair), high, step / 2)
        found[segment[after <= 0.0]] = 1.0
        found[segment[before <= 0.0]] = 0.0
        while True:
            doubtful = before + after <= step
            stuck = doubtful & (step <= PATH_RESOLUTION_M)
            found[segment[stuck]] = low[stuck]
            left = np.flatnonzero(doubtful & np.isnan(found[segment]))
            if not len(left):
                return found
            segment, pair, step = segment[left], pair[left], step[left]
            low, high, before, after = low[left], high[left], before[left], after[left]
            middle = (low + high) / 2
            between = gaps((segment, pair), middle, step / 2)
            found[segment[between <= 0.0]] = middle[between <= 0.0]
            segment, pair, step = (
                np.concatenate([segment, segment]),
                np.concatenate([pair, pair]),
                np.concatenate([step, step]) / 2,
            )
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
            before, after = np.concatenate([before, between]), np.concatenate([between, after])


def _length(segments: Floats) -> Floats:
    """Return the lengths (m,) [m] of segments (m, 2, 3)."""
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)


def space_of(arm: ArmConfig, robot: Robot, lower_rad: Floats, upper_rad: Floats) -> Space:
    """Return the collision pairs of a configured arm in its joint range.

    Checked pairs: links and load against planes, boxes, base and column, and against one another if at least one link
    is between them. Neighbouring links touch at their joint and are left out. Bodies that touch at all joint positions
    are also left out (all of `SAMPLES` random postures; `ALWAYS` of them if a shape is assumed). Planes and boxes are
    never left out for a link beyond the first.
    """
    planes, boxes_m, fixed_parts = surroundings_of(arm, robot)
    body = body_of_parts([*fixed_parts, *moving_parts(arm, robot)])
    return space_between(robot, body, boxes_m, planes, (lower_rad, upper_rad))


def space_between(
    robot: Robot, body: Body, boxes_m: Floats, planes: tuple[Plane, ...], range_rad: tuple[Floats, Floats]
) -> Space:
    """Return the collision pairs for given bodies, boxes (b, 2, 3), planes, and ends (N,) of the joint range.

    See `space_of`.
    """
    everything = _all_pairs(body, robot, len(boxes_m), len(planes))
    exact = Exact(body, boxes_m, 2.0 * reach_m(robot) + float(np.linalg.norm(body.end_m, axis=1).max()) + 1.0)
    space = Space(robot, body, boxes_m, planes, everything, np.zeros(len(everything.kind), dtype=bool), (), exact)
    always = _always(space, *range_rad)
    names = dict.fromkeys(space.name_of(int(row)) for row in np.flatnonzero(always))
    space = replace(space, pairs=everything.only(~always), narrow=space.narrow[~always], unchecked=tuple(names))
    return replace(space, narrow=_always(space.with_clearance(), *range_rad))


def _all_pairs(body: Body, robot: Robot, boxes: int, planes: int) -> Pairs:
    levers = body.levers_m(robot)
    joints = np.arange(robot.axes)
    rows: list[tuple[int, int, int, Floats]] = []
    for first, link in enumerate(body.link):
        if link == BASE:
            continue
        rows += [(BOX, first, box, levers[first]) for box in range(boxes)]
        rows += [(PLANE, first, plane, levers[first]) for plane in range(planes)]
        # a load turns against the link before the last, that carries it, as the last link does
        neighbour = link if body.parts[body.part[first]].name == LOAD else link - 1
        for other, before in enumerate(body.link):
            if before < neighbour:
                rows.append((SOLID, first, other, np.where(joints > before, levers[first], 0.0)))
    return Pairs(
        kind=np.array([row[0] for row in rows], dtype=np.intp),
        first=np.array([row[1] for row in rows], dtype=np.intp),
        other=np.array([row[2] for row in rows], dtype=np.intp),
        lever_m=np.array([row[3] for row in rows]).reshape(-1, robot.axes),
        clearance_m=np.zeros(len(rows)),
    )


def _always(space: Space, lower_rad: Floats, upper_rad: Floats) -> NDArray[np.bool_]:
    """Return the pairs (p,) that touch at all joint positions."""
    pairs, body = space.pairs, space.body
    middle, half = (upper_rad + lower_rad) / 2, np.minimum((upper_rad - lower_rad) / 2, np.pi)
    q_rad = middle + half * np.random.default_rng(_SEED).uniform(-1, 1, (SAMPLES, space.robot.axes))
    known = np.array([part.known for part in body.parts], dtype=bool)[body.part]
    between = pairs.kind == SOLID
    left_out = between | (body.link[pairs.first] == 0)
    certain = known[pairs.first] & (~between | known[np.where(between, pairs.other, 0)])
    most_clear = np.where(certain, 0, int((1.0 - ALWAYS) * SAMPLES))
    clear = np.zeros(len(pairs.kind), dtype=int)
    for begin in range(0, SAMPLES, 20):
        doubtful = np.flatnonzero(left_out & (clear <= most_clear))
        posture, pair = np.repeat(np.arange(20), len(doubtful)), np.tile(doubtful, 20)
        gaps = space.gaps_m(q_rad[begin : begin + 20], posture, pair, np.zeros(len(pair)))
        np.add.at(clear, pair[gaps > 0.0], 1)
    return left_out & (clear <= most_clear)
