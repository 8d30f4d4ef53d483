"""Choice of an excitation series: draw random series, optimise the best ones, prove the result collision-free."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import PlanRefused
from gateway.excite.expected import AskedNumbers, mean_log_std
from gateway.excite.fourier_family import Family
from gateway.excite.limits import MovingLimits
from gateway.excite.random_series import Members, fitted, random_members, rows_of
from gateway.excite.series_optimiser import Aim, improved
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

HARMONICS = 5
#: Instants of a period at which limits are checked: during the choice, and for the final amplitude.
INSTANTS, DENSE = 64, 500
#: Random series that are optimised, steps of each, and further steps of the best one. Half the steps where there are
#: more parameters than `MANY_UNKNOWNS`, as with unknown links.
TRIES, FIRST_STEPS, MORE_STEPS, MANY_UNKNOWNS = 2, 30, 60, 40
#: Factor on the amplitude and number of tries where bodies touch between the instants.
_SMALLER, _SHRUNK = 0.97, 12


@dataclass(frozen=True, slots=True, eq=False)
class ChosenSeries:
    """Chosen excitation series and its rating.

    Attributes
    ----------
    family : Family
        Family at whose instants the amplitude was limited.
    members : Members
        The single member.
    over_random : float
        Geometric mean of its expected standard deviations over those of the best random series; 1 = that series.
    """

    family: Family
    members: Members
    over_random: float


@dataclass(frozen=True, slots=True, eq=False)
class SeriesTask:
    """Limits and purpose of a series.

    Attributes
    ----------
    limits : MovingLimits
    anchors_rad : array of shape (k, N)
        The start needs a straight path from at least one of these postures, if there are any.
    asked : tuple of AskedNumbers
    period_s : float
    periods : int
    """

    limits: MovingLimits
    anchors_rad: Floats
    asked: tuple[AskedNumbers, ...]
    period_s: float
    periods: int

    def log_std(self, family: Family, members: Members) -> Floats:
        """Return the mean logarithm (m,) of the expected standard deviations of each of several series."""
        states, rigid = rows_of(self.limits, family, members)
        return mean_log_std(self.asked, states, rigid, len(members), self.periods * self.period_s)


def best_random(task: SeriesTask, starts_rad: Floats, random: np.random.Generator) -> ChosenSeries:
    """Return the collision-free random series with the smallest expected deviations, one from each start (m, N)."""
    members = _drawn(task, starts_rad, random)
    family = Family.of(task.period_s, HARMONICS, INSTANTS)
    order = np.argsort(task.log_std(family, members))
    return _first_clear(task, [members.only(np.array([row])) for row in order])


def optimised(task: SeriesTask, starts_rad: Floats, random: np.random.Generator) -> ChosenSeries:
    """Return the optimised series; it starts from the same random series as `best_random`."""
    members = _drawn(task, starts_rad, random)
    family = Family.of(task.period_s, HARMONICS, INSTANTS)
    order = np.argsort(task.log_std(family, members))
    reference = _first_clear(task, [members.only(np.array([row])) for row in order])
    aim = Aim(family, task.limits, task.asked, task.periods * task.period_s)
    fewer = 2 if max(len(each.prior.std) for each in task.asked) > MANY_UNKNOWNS else 1
    tried = [improved(aim, members.only(order[k : k + 1]), FIRST_STEPS // fewer) for k in range(TRIES)]
    tried.sort(key=_value)
    final = improved(aim, tried[0][0], MORE_STEPS // fewer)
    chosen = _first_clear(task, [final[0], *(member for member, _ in tried), reference.members])
    gained = task.log_std(chosen.family, chosen.members) - task.log_std(reference.family, reference.members)
    return replace(chosen, over_random=float(np.exp(gained[0])))


def _value(found: tuple[Members, float]) -> float:
    return found[1]


def _drawn(task: SeriesTask, starts_rad: Floats, random: np.random.Generator) -> Members:
    return random_members(Family.of(task.period_s, HARMONICS, INSTANTS), task.limits, starts_rad, random)


def _first_clear(task: SeriesTask, candidates: list[Members]) -> ChosenSeries:
    """Return the first series with a reachable start that keeps all limits, with a smaller amplitude if needed."""
    family = Family.of(task.period_s, HARMONICS, DENSE)
    for candidate in candidates:
        if not _reached(task.limits.workspace, task.anchors_rad, candidate.start_rad[0]):
            continue
        member = fitted(family, task.limits, candidate)
        for _ in range(_SHRUNK):
            if not np.abs(member.free).max() > 0.0:
                break
            path = family.states(member.start_rad, member.free).q_rad
            if task.limits.workspace.refused_on(np.vstack([path, member.start_rad])) is None:
                return ChosenSeries(family, member, 1.0)
            member = member.scaled(np.array([_SMALLER]))
    raise PlanRefused(
        "no motion of all joints is within the limits from any tested start: widen position_limit_rad, or correct the"
        " assumed surroundings in the cell file (floor_m, wall, column_radius_m, link_radius_m, load_size_m)"
    )


def _reached(workspace: Workspace, anchors_rad: Floats, start_rad: Floats) -> bool:
    """Return True if the arm may rest at a start (N,) and a straight path from an anchor (k, N) is free."""
    if not workspace.feasible(start_rad[None], torque_share=workspace.rest_share)[0]:
        return False
    starts = np.tile(start_rad, (len(anchors_rad), 1))
    return not len(anchors_rad) or bool(workspace.path_clear(anchors_rad, starts).any())
