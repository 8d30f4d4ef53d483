"""The series of a plan: random ones, the best of them improved, and the first that is proven clear."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import PlanRefused
from gateway.excite.design import Members, fitted, random_members, rows_of
from gateway.excite.expected import AskedNumbers, promise
from gateway.excite.family import Family
from gateway.excite.limits import MovingLimits
from gateway.excite.optimise import Aim, improved
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

HARMONICS = 5
#: Instants of a period at which limits are looked at while a motion is chosen, and when its size is settled.
INSTANTS, DENSE = 64, 500
#: How many of the random motions are improved, by how many steps, and the best of these by how many more; half as many
#: where there are more unknowns than this, as with all links.
TRIES, FIRST_STEPS, MORE_STEPS, MANY_UNKNOWNS = 2, 30, 60, 40
#: Smaller by this much, so often, where something is touched between the instants.
_SMALLER, _SHRUNK = 0.97, 12


@dataclass(frozen=True, slots=True, eq=False)
class ChosenSeries:
    """A series and what it is worth.

    Attributes
    ----------
    family : Family
        That its size was settled with.
    members : Members
        The one member.
    over_random : float
        Its expected standard deviations over those of the best random one, geometric mean; 1 = that one itself.
    """

    family: Family
    members: Members
    over_random: float


@dataclass(frozen=True, slots=True, eq=False)
class SeriesTask:
    """What a series is chosen for.

    Attributes
    ----------
    limits : MovingLimits
    anchors_rad : array of shape (k, N)
        Postures of which one has to have a straight way to the start; none where the arm may stand at none of them.
    asked : tuple of AskedNumbers
    period_s : float
    periods : int
    """

    limits: MovingLimits
    anchors_rad: Floats
    asked: tuple[AskedNumbers, ...]
    period_s: float
    periods: int

    def promises(self, family: Family, members: Members) -> Floats:
        """Mean logarithm (m,) of the standard deviations that each of several series promises."""
        states, rigid = rows_of(self.limits, family, members)
        return promise(self.asked, states, rigid, len(members), self.periods * self.period_s)


def best_random(task: SeriesTask, starts_rad: Floats, random: np.random.Generator) -> ChosenSeries:
    """The random series, one from each start (m, N), that promises most and is proven clear."""
    members = _drawn(task, starts_rad, random)
    family = Family.of(task.period_s, HARMONICS, INSTANTS)
    order = np.argsort(task.promises(family, members))
    return _first_clear(task, [members.only(np.array([row])) for row in order])


def optimised(task: SeriesTask, starts_rad: Floats, random: np.random.Generator) -> ChosenSeries:
    """The best random series, improved; the same random ones as those of `best_random`."""
    members = _drawn(task, starts_rad, random)
    family = Family.of(task.period_s, HARMONICS, INSTANTS)
    order = np.argsort(task.promises(family, members))
    reference = _first_clear(task, [members.only(np.array([row])) for row in order])
    aim = Aim(family, task.limits, task.asked, task.periods * task.period_s)
    fewer = 2 if max(len(each.prior) for each in task.asked) > MANY_UNKNOWNS else 1
    tried = [improved(aim, members.only(order[k : k + 1]), FIRST_STEPS // fewer) for k in range(TRIES)]
    tried.sort(key=_value)
    final = improved(aim, tried[0][0], MORE_STEPS // fewer)
    chosen = _first_clear(task, [final[0], *(member for member, _ in tried), reference.members])
    gained = task.promises(chosen.family, chosen.members) - task.promises(reference.family, reference.members)
    return replace(chosen, over_random=float(np.exp(gained[0])))


def _value(found: tuple[Members, float]) -> float:
    return found[1]


def _drawn(task: SeriesTask, starts_rad: Floats, random: np.random.Generator) -> Members:
    return random_members(Family.of(task.period_s, HARMONICS, INSTANTS), task.limits, starts_rad, random)


def _first_clear(task: SeriesTask, candidates: list[Members]) -> ChosenSeries:
    """The first that keeps all limits on its whole way, made smaller if need be, and whose start can be reached."""
    family = Family.of(task.period_s, HARMONICS, DENSE)
    for candidate in candidates:
        if not _reached(task.limits.workspace, task.anchors_rad, candidate.start_rad[0]):
            continue
        member = fitted(family, task.limits, candidate)
        for _ in range(_SHRUNK):
            if not np.abs(member.free).max() > 0.0:
                break
            way = family.states(member.start_rad, member.free).q_rad
            if task.limits.workspace.refused_on(np.vstack([way, member.start_rad])) is None:
                return ChosenSeries(family, member, 1.0)
            member = member.scaled(np.array([_SMALLER]))
    raise PlanRefused(
        "no motion of all joints keeps the limits from any start that was tried: widen position_limit_rad, or say in "
        "the cell what is assumed (floor_m, wall, column_radius_m, link_radius_m, load_size_m)"
    )


def _reached(workspace: Workspace, anchors_rad: Floats, start_rad: Floats) -> bool:
    """Whether the arm may rest at a start (N,), and a straight way leads there from one of the anchors (k, N)."""
    if not workspace.feasible(start_rad[None], torque_share=workspace.rest_share)[0]:
        return False
    ways = np.tile(start_rad, (len(anchors_rad), 1))
    return not len(anchors_rad) or bool(workspace.path_clear(anchors_rad, ways).any())
