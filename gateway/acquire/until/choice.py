"""What to measure next, and when a load is known well enough: pure, from what is known to a decision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.outlook import Outlook
from gateway.result.interval import half_width

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Poses of a load before it may count as known, and at most: the noise has to be measured, and the duration is limited.
LEAST_POSES: Final = 4
MOST_POSES: Final = 40
#: Least samples a side: fewer do not determine their scatter.
LEAST_SAMPLES: Final = 20
#: Where the goal is out of reach, a half width so close to what `MOST_POSES` would leave is worth no further pose.
NEAR: Final = 1.25
#: Numbers of samples that are held against one another.
_COUNTS: Final = 5
#: Candidates among which the poses to come are looked ahead.
_AHEAD: Final = 80
#: The first poses to come are looked ahead one by one, later ones so many at once.
_SINGLY: Final = 6
_TOGETHER: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Postures that may be measured next, n of them.

    Attributes
    ----------
    q_rad : array of shape (n, N)
    regressor : array of shape (n, N, 4 N)
        Gravity regressors.
    """

    q_rad: Floats
    regressor: Floats

    def __len__(self) -> int:
        """How many."""
        return len(self.q_rad)


@dataclass(frozen=True, slots=True)
class Sampling:
    """How long a pose is sampled.

    Attributes
    ----------
    period_s : float
        SYNC period.
    most : int
        Samples a side at most: those of the cell.
    """

    period_s: float
    most: int

    @property
    def least(self) -> int:
        """Samples a side at least."""
        return min(LEAST_SAMPLES, self.most)


@dataclass(frozen=True, slots=True, eq=False)
class Narrowness:
    """How far a load is known against how far it shall be; arrays (4,) of mass [kg] and centre of gravity [m].

    Attributes
    ----------
    half : half widths of the 95 % intervals now
    goal : those asked for, infinite where nothing is
    limit : those that are left after `MOST_POSES`
    poses : of this load so far
    ahead : poses that are still expected to be needed
    """

    half: Floats
    goal: Floats
    limit: Floats
    poses: int
    ahead: int

    @property
    def reached(self) -> Bools:
        """Which are known well enough (4,)."""
        return self.half <= self.goal

    @property
    def hopeless(self) -> Bools:
        """Which no pose brings that far (4,)."""
        return ~self.reached & (self.limit > self.goal)

    @property
    def aim(self) -> Floats:
        """Half widths (4,) worth going on for: the goal, and where that is out of reach, what is near the limit."""
        return np.where(self.limit > self.goal, NEAR * self.limit, self.goal)

    @property
    def done(self) -> bool:
        """Whether nothing more is to be measured."""
        if self.poses < LEAST_POSES:
            return False
        return self.poses >= MOST_POSES or bool((self.half <= self.aim).all())


def judge(known: Outlook, half: Floats, goal: Floats, poses: int, choice: Candidates, sampling: Sampling) -> Narrowness:
    """Hold a load against the goal, and look ahead to what more poses would give.

    Parameters
    ----------
    known : Outlook
    half : array of shape (4,)
        Half widths as estimated.
    goal : array of shape (4,)
    poses : int
        Of this load, so far.
    choice : Candidates
    sampling : Sampling
    """
    asked = np.isfinite(goal)
    if not asked.any() or (poses >= LEAST_POSES and (half <= goal).all()):
        return Narrowness(half, goal, np.zeros(4), poses, 0)
    some = choice.regressor[:_AHEAD]
    done = poses
    while done < MOST_POSES and (done < LEAST_POSES or (half_width(1.0) * known.std > goal).any()):
        after = known.std_after(some, sampling.most)
        count = min(1 if done - poses < _SINGLY else _TOGETHER, MOST_POSES - done)
        known = known.with_poses(some[int(np.argmin(_left(after, goal)))], sampling.most, count)
        done += count
    return Narrowness(half, goal, np.where(asked, half_width(1.0) * known.std, 0.0), poses, done - poses)


def best_first(
    known: Outlook, verdict: Narrowness, choice: Candidates, seconds: Floats, sampling: Sampling
) -> tuple[NDArray[np.int_], int]:
    """Candidates by decreasing information per second, and the samples a side.

    Parameters
    ----------
    known : Outlook
    verdict : Narrowness
    choice : Candidates
    seconds : array of shape (n,)
        Time of the path to each, both approaches and settling, sampling not included; infinite = out of question.
    sampling : Sampling

    Returns
    -------
    rows : int array of shape (k,)
        Of those that are in question.
    samples : int
    """
    before = _left(known.std[None], verdict.aim)
    counts = np.unique(np.geomspace(sampling.least, sampling.most, _COUNTS).round().astype(int)).tolist()
    rates = []
    for samples in counts:
        gain = before - _left(known.std_after(choice.regressor, samples), verdict.aim)
        rates.append(np.where(np.isfinite(seconds), gain / (seconds + 2.0 * samples * sampling.period_s), -np.inf))
    best = int(np.argmax([rate.max(initial=-np.inf) for rate in rates]))
    order = np.argsort(-rates[best], kind="stable")
    return order[np.isfinite(seconds[order])], counts[best]


def _left(std: Floats, aim: Floats) -> Floats:
    """How far standard deviations (n, 4) are still from the half widths aimed at (4,): sum of logarithms, 0 = there."""
    asked = np.isfinite(aim) & (aim > 0)
    ratio = half_width(1.0) * std[:, asked] / aim[asked]
    return np.log(np.maximum(ratio, 1.0)).sum(axis=1)
