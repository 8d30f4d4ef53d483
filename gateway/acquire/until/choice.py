"""Decide which pose to measure next and when a load's uncertainty is small enough; pure functions of the present
estimate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.expected_information import ExpectedInformation
from gateway.result.interval import half_width

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Smallest and largest number of poses of a load: the noise has to be measured, and the duration is limited.
LEAST_POSES: Final = 4
MOST_POSES: Final = 40
#: Smallest number of samples per approach direction: fewer do not determine their scatter.
LEAST_SAMPLES: Final = 20
#: If the goal is not reachable: stop at this ratio to the half width expected after `MOST_POSES` poses.
NEAR: Final = 1.25
#: Numbers of samples that are compared.
_COUNTS: Final = 5
#: Number of candidates in the prediction of further poses.
_AHEAD: Final = 80
#: The first further poses are predicted one by one, later ones in blocks of this size.
_SINGLY: Final = 6
_TOGETHER: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Candidate postures for the next measurement, n of them.

    Attributes
    ----------
    q_rad : array of shape (n, N)
    regressor : array of shape (n, N, 4 N)
        Gravity regressors.
    """

    q_rad: Floats
    regressor: Floats

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.q_rad)


@dataclass(frozen=True, slots=True)
class Sampling:
    """Settings of the number of samples per pose.

    Attributes
    ----------
    period_s : float
        SYNC period.
    most : int
        Largest number of samples per approach direction: that of the cell file.
    """

    period_s: float
    most: int

    @property
    def least(self) -> int:
        """Smallest number of samples per approach direction."""
        return min(LEAST_SAMPLES, self.most)


@dataclass(frozen=True, slots=True, eq=False)
class Narrowness:
    """Half widths of the 95 % intervals and their goal; arrays (4,) of mass [kg] and centre of gravity [m].

    Attributes
    ----------
    half : present half widths
    goal : requested half widths, infinite without a request
    limit : expected half widths after `MOST_POSES` poses
    poses : poses of this load measured so far
    ahead : further poses that are expected to be needed
    """

    half: Floats
    goal: Floats
    limit: Floats
    poses: int
    ahead: int

    @property
    def reached(self) -> Bools:
        """Mask (4,) of the half widths that have reached their goal."""
        return self.half <= self.goal

    @property
    def hopeless(self) -> Bools:
        """Mask (4,) of the half widths that no number of poses brings to their goal."""
        return ~self.reached & (self.limit > self.goal)

    @property
    def aim(self) -> Floats:
        """Half widths (4,) to measure for: the goal, or a value near the limit where the goal is not reachable."""
        return np.where(self.limit > self.goal, NEAR * self.limit, self.goal)

    @property
    def done(self) -> bool:
        """True if no further pose is worth measuring."""
        if self.poses < LEAST_POSES:
            return False
        return self.poses >= MOST_POSES or bool((self.half <= self.aim).all())


def judge(
    known: ExpectedInformation, half: Floats, goal: Floats, poses: int, choice: Candidates, sampling: Sampling
) -> Narrowness:
    """Compare a load's half widths with the goal, and predict those after further poses.

    Parameters
    ----------
    known : ExpectedInformation
    half : array of shape (4,)
        Estimated half widths.
    goal : array of shape (4,)
    poses : int
        Number of poses of this load so far.
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
    known: ExpectedInformation, verdict: Narrowness, choice: Candidates, seconds: Floats, sampling: Sampling
) -> tuple[NDArray[np.int_], int]:
    """Sort the candidates by decreasing information per second; also return the samples per approach direction.

    Parameters
    ----------
    known : ExpectedInformation
    verdict : Narrowness
    choice : Candidates
    seconds : array of shape (n,)
        Time of the path, both approaches and settling, without sampling; infinite = excluded.
    sampling : Sampling

    Returns
    -------
    rows : int array of shape (k,)
        Indices of the candidates that are not excluded.
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
    """Return the distance of standard deviations (n, 4) to the aimed half widths (4,): sum of logarithms."""
    asked = np.isfinite(aim) & (aim > 0)
    ratio = half_width(1.0) * std[:, asked] / aim[asked]
    return np.log(np.maximum(ratio, 1.0)).sum(axis=1)
