"""Random excitation series: Fourier series that start at rest, each scaled up to its first limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from gateway.errors import PlanRefused
from gateway.excite.excitation import Series
from gateway.excite.expected import arm_rows
from gateway.excite.limits import MovingLimits, States
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

#: Number of random series.
RANDOM = 100
#: Postures per draw, and largest number of draws.
DRAWN, DRAWS = 400, 20
#: Bisection steps for the amplitude: a resolution of 1 / 250 of the largest one.
HALVINGS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Family of series with fixed harmonics and period that start at rest: speed and acceleration are zero at t = 0.

    A member is its start (N,) and free numbers (F, N), F = 2 (harmonics - 1): coordinates in the null space of both
    conditions, so that every member satisfies them.

    Attributes
    ----------
    period_s : float
    basis : array of shape (2, harmonics, F)
        Cosine and sine coefficients of each free number.
    shapes : array of shape (4, n, F)
        Position, speed, acceleration and jerk of each free number at instants spread evenly over a period.
    """

    period_s: float
    basis: Floats
    shapes: Floats

    @classmethod
    def of(cls, period_s: float, harmonics: int, instants: int) -> Family:
        """Return the family of a period, evaluated at `instants` times in it."""
        order = np.arange(1.0, harmonics + 1)
        cosine, sine = null_space(order[None] ** 2), null_space(order[None])
        nothing = np.zeros_like(cosine)
        basis = np.stack([np.hstack([cosine, nothing]), np.hstack([nothing, sine])])
        columns = Series("", np.zeros(basis.shape[2]), basis[0].T, basis[1].T, period_s, 1)
        return cls(period_s, basis, np.stack(columns.at(np.arange(instants) * period_s / instants)))

    @property
    def free(self) -> int:
        """Number of free coefficients per joint."""
        return self.basis.shape[2]

    def states(self, start_rad: Floats, free: Floats) -> States:
        """Return the states of the members at all instants, one member after the other.

        Parameters
        ----------
        start_rad : array of shape (m, N)
        free : array of shape (m, F, N)

        Returns
        -------
        States
            Arrays of shape (m n, N).
        """
        moved = np.einsum("dnf,mfj->dmnj", self.shapes, free)
        moved[0] += start_rad[:, None]
        return States(*moved.reshape(4, -1, start_rad.shape[1]))

    def series(self, name: str, start_rad: Floats, free: Floats, periods: int) -> Series:
        """Return one member as a series, from its start (N,) and free numbers (F, N)."""
        cosine, sine = self.basis @ free
        return Series(name, start_rad, cosine.T, sine.T, self.period_s, periods)


@dataclass(frozen=True, slots=True, eq=False)
class Members:
    """Several series of one family.

    Attributes
    ----------
    start_rad : array of shape (m, N)
    free : array of shape (m, F, N)
    """

    start_rad: Floats
    free: Floats

    def __len__(self) -> int:
        """Return the number of series."""
        return len(self.free)

    def only(self, rows: NDArray[np.intp]) -> Members:
        """Return a selection of the series."""
        return Members(self.start_rad[rows], self.free[rows])

    def scaled(self, factor: Floats) -> Members:
        """Return the series with the amplitude multiplied by a factor (m,), about the same start."""
        return Members(self.start_rad, factor[:, None, None] * self.free)


def start_postures(limits: MovingLimits, anchors_rad: Floats, random: np.random.Generator) -> Floats:
    """Return postures (RANDOM, N) where the arm may rest and that a straight path reaches.

    Parameters
    ----------
    limits : MovingLimits
    anchors_rad : array of shape (k, N)
        The straight path starts at one of these postures, if there are any.
    random : Generator

    Raises
    ------
    PlanRefused
        Too few such postures; the most frequent violation is named.
    """
    workspace = limits.workspace
    found: list[Floats] = []
    for _ in range(DRAWS):
        drawn = workspace.draw(random, DRAWN)
        good = drawn[workspace.feasible(drawn, torque_share=workspace.rest_share) & _can_rest(limits, drawn)]
        if len(anchors_rad):
            joined = [workspace.path_clear(np.tile(anchor, (len(good), 1)), good) for anchor in anchors_rad]
            good = good[np.any(joined, axis=0)]
        found.extend(good)
        if len(found) >= RANDOM:
            return np.array(found[:RANDOM])
    against = workspace.violations(workspace.draw(random, DRAWN), torque_share=workspace.rest_share)
    words = max(against, key=lambda each: float(each[1].mean()))[0]
    raise PlanRefused(
        f"{len(found)} of {DRAWN * DRAWS} random postures can be reached and held, {RANDOM} are needed to choose a "
        f"motion from; most often: {words}. Widen the limits, or correct the assumed surroundings in the cell file"
        " (floor_m, wall, "
        "column_radius_m, link_radius_m, load_size_m)"
    )


def _can_rest(limits: MovingLimits, q_rad: Floats) -> NDArray[np.bool_]:
    """Return a mask (n,) of postures (n, N) within all limits at rest."""
    still = np.zeros_like(q_rad)
    return limits.shares(States(q_rad, still, still, still)).max(axis=1) < 1.0


def random_members(family: Family, limits: MovingLimits, start_rad: Floats, random: np.random.Generator) -> Members:
    """Return one random series from each start (m, N), each scaled up to its first limit."""
    axes = start_rad.shape[1]
    drawn = random.standard_normal((len(start_rad), family.free, axes)) * limits.speed_rad_s
    return fitted(family, limits, Members(start_rad, drawn))


def fitted(family: Family, limits: MovingLimits, members: Members) -> Members:
    """Return the members with the largest amplitude that limits and surroundings allow."""
    peak = np.abs(np.einsum("nf,mfj->mnj", family.shapes[1], members.free)).max(axis=1) / limits.speed_rad_s
    largest = 1.0 / np.maximum(peak.max(axis=1), 1e-12)  # no larger one keeps the speed limits
    inside = _largest(members, largest, lambda tried: _inside(family, limits, tried))
    return members.scaled(_largest(members, inside, lambda tried: _apart(family, limits.workspace, tried)))


def _largest(members: Members, high: Floats, keeps: Callable[[Members], NDArray[np.bool_]]) -> Floats:
    """Return the largest amplitudes (m,) up to `high` for which `keeps` is true; it is true for all smaller ones."""
    good = keeps(members.scaled(high))
    found = np.where(good, high, 0.0)
    left = np.flatnonzero(~good)
    low, high = np.zeros(len(left)), high[left]
    for _ in range(HALVINGS if len(left) else 0):
        middle = (low + high) / 2
        good = keeps(members.only(left).scaled(middle))
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    found[left] = low
    return found


def _inside(family: Family, limits: MovingLimits, members: Members) -> NDArray[np.bool_]:
    """Return a mask (m,) of the series within all limits at the instants of the family."""
    share = limits.shares(family.states(members.start_rad, members.free))
    return share.max(axis=1).reshape(len(members), -1).max(axis=1) <= 1.0


def _apart(family: Family, workspace: Workspace, members: Members) -> NDArray[np.bool_]:
    """Return a mask (m,) of the series that are collision-free at the instants of the family."""
    q_rad = family.states(members.start_rad, members.free).q_rad
    touching = workspace.space.touching(q_rad).reshape(len(members), -1)
    return ~np.asarray(np.any(touching, axis=1), dtype=bool)


def rows_of(limits: MovingLimits, family: Family, members: Members) -> tuple[States, Floats]:
    """Return the states of several series, one after the other, and the regressor of the arm at these."""
    states = family.states(members.start_rad, members.free)
    return states, arm_rows(limits.workspace, states)
