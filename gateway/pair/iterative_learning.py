"""Iterative learning control: the second function of the pair is learned while the pair runs.

`CorrectionStore` keeps the corrections of the newest cycles, for every command of the path and both arms (CN104379308,
blocks 111a, 111b).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.calibration import PairCalibration
from gateway.pair.learning_points import Record, prune, refine, score, select
from gateway.pair.learning_update import (
    LearningRule,
    at_points,
    from_local,
    largest_change,
    led,
    local,
    raw_relation,
    representative,
    smoothed,
)
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats, apply_correction, correction_between, inverse
from gateway.pair.transform_function import TransformFunction

SETTLED_M, SETTLED_RAD = 0.05e-3, 0.2e-3
SETTLED_CYCLES = 2


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """Data of one complete cycle.

    Attributes
    ----------
    master_base, slave_base : arrays of shape (M, 4, 4)
        Commands before correction [m].
    corrections : array of shape (M, 2, 6)
    force : array of shape (M, 6), internal wrench
    left : array of shape (M, 6), optional
        Remaining correction of the slave's hand at each command for the remaining force [m, rad], base axes.
    trust : array of shape (M,), optional
        From 0 to 1: weight of the learned function against the first one.
    """

    master_base: Floats
    slave_base: Floats
    corrections: Floats
    force: Floats
    left: Floats | None = None
    trust: Floats | None = None


@dataclass(frozen=True, slots=True)
class Learned:
    """Result of a learning step; `change` is the change of the function at its knots."""

    updated: bool
    knots: int
    change_m: float = 0.0
    change_rad: float = 0.0


class IterativeLearning:
    """Iterative learning of the second function by a rule; no clock, no I/O.

    Parameters
    ----------
    rule : LearningRule
    path : PairPath
    calibration : PairCalibration
    first : TransformFunction
    lead : int
        How many commands later a correction is read.

    Attributes
    ----------
    master_offset : array of shape (M, 6)
        Own corrections that the master has adopted (fig. 15). A mean applied to the slave alone would persist after its
        cause: once the function holds the corrections of both hands, the force vanishes, the master no longer yields,
        and the slave would still follow its old correction.
    """

    def __init__(
        self, rule: LearningRule, path: PairPath, calibration: PairCalibration, first: TransformFunction, lead: int
    ) -> None:
        self._rule, self._path, self._calibration, self._lead = rule, path, calibration, lead
        self.first = first
        self._reference = first.many(path.s_m)
        self._store = CorrectionStore(rule.cycles, len(path))
        self.reset()

    def reset(self) -> None:
        """Delete the learned function and all stored cycles."""
        self.second: TransformFunction | None = None
        self.master_offset = np.zeros((len(self._path), 6))
        self._store.clear()
        self._points = np.unique(np.append(self._path.nearest(self.first.s_m), [0, len(self._path) - 1]))
        self._forces: list[Floats] = []
        self._force_before = np.zeros((len(self._path), 6))
        self._change_before = np.zeros((len(self._path), 6))
        self._settled = 0
        self._in_use = self._was_inside = False
        self._first_force = np.inf
        self._last_change, self._growing = np.inf, 0

    @property
    def in_use(self) -> TransformFunction:
        """Return the function of the next cycle."""
        return self.second if self.second is not None and self._in_use else self.first

    @property
    def points(self) -> np.ndarray:
        """Return the indices of the learning points."""
        return self._points.copy()

    def learn(self, cycle: Cycle) -> Learned:
        """Take one complete cycle; rebuild the second function when the rule requires it.

        A block is not waited for until the force has once been inside its limit: what is far off is far off in every
        cycle, and the part is to be spared another one.
        """
        self._was_inside |= largest_n(cycle) <= self._calibration.force_limit_n
        self._store.add(self._asked(cycle))
        self._forces = [*self._forces, cycle.force][-self._rule.cycles :]
        if self._rule.schedule == "block" and self._was_inside and not self._store.full:
            return Learned(False, len(self.in_use))
        typical = representative(self._store.corrections, self._rule.kind)
        raw = raw_relation(self._calibration.bases, cycle.master_base, self._slave_of(cycle, typical), typical)
        present = self.in_use.many(self._path.s_m)
        before = local(present, self._reference)
        change = local(raw, self._reference) - before
        coordinates = self._rule.forgetting.update(
            before, change, self._change_before, self._path.duration_s * len(self._store)
        )
        if cycle.trust is not None:
            coordinates = cycle.trust[:, None] * coordinates
        self._change_before = change
        updated = from_local(coordinates, self._reference)
        self._choose_points(typical[:, 1], None if cycle.left is None else updated)
        function = at_points(updated, self._path.s_m, self._points)
        if self._rule.selection is not None and self._rule.selection.keep == "union":
            function = prune(self._rule.selection, function)
            self._points = self._path.nearest(function.s_m)
        taken_over = self._rule.figure == 15 and self._rule.source == "command"
        master = typical[:, 0] if taken_over else np.zeros_like(typical[:, 0])
        arc_m = self._path.s_m
        last = self.first if self.second is None else self.second
        change_m, change_rad = largest_change(function.many(arc_m)[self._points], last.many(arc_m)[self._points])
        present = self.in_use
        self.second = function
        moved_master = apply_correction(cycle.master_base, master)
        self.master_offset = correction_between(moved_master, self._path.commands)
        self._choose(largest_n(cycle), change_m, change_rad)
        if self._rule.schedule == "block":
            self._store.clear()
        else:
            shared = inverse(self._calibration.w_t_b2) @ self._calibration.w_t_b1 @ self._path.commands
            moved = correction_between(shared @ self.in_use.many(arc_m), shared @ present.many(arc_m))
            self._store.rereference(np.stack([master, moved], axis=1))
        return Learned(True, len(function), change_m, change_rad)

    def _asked(self, cycle: Cycle) -> Floats:
        """Return the corrections (M, 2, 6) of a cycle, each at the command that it belongs to.

        A correction is delayed against the force that caused it. Where the remaining force is known, the corrections
        stay at their commands, and the missing part is added.
        """
        width = round(0.5 * self._rule.smooth_s / self._path.dt_s)
        corrections = smoothed(cycle.corrections, width)
        if cycle.left is None:
            return led(corrections, self._lead)
        corrections[:, 1] += self._rule.left_share * smoothed(cycle.left, width)
        return corrections

    def _slave_of(self, cycle: Cycle, typical: Floats) -> Floats:
        """Slave's second learning commands: the function applied to the corrected commands of the master (fig. 14)."""
        if self._rule.figure == 15:
            return cycle.slave_base
        shared = inverse(self._calibration.w_t_b2) @ self._calibration.w_t_b1
        return shared @ apply_correction(cycle.master_base, typical[:, 0]) @ self.in_use.many(self._path.s_m)

    def _choose_points(self, correction: Floats, wanted: Floats | None) -> None:
        """Return the points of the next function; `wanted` (M, 4, 4) is the known relation at every command."""
        selection = self._rule.selection
        if selection is None:
            return
        force = np.mean(self._forces, axis=0)
        record = Record(force, correction, self._force_before)
        self._force_before = force
        self._points = select(selection, score(selection, record, self._path), self._path, self._points)
        if selection.gain_n and wanted is not None:
            stiffness = np.diag(self._calibration.chain_stiffness)[[0, 3]]
            self._points = refine(selection, wanted, self._path, self._points, stiffness)

    def _choose(self, force: float, change_m: float, change_rad: float) -> None:
        """Which function the next cycle uses.

        With "convergence" the second one is used once its knots have moved less than 0.05 mm and 0.2 mrad in two
        successive updates, and given up when the force exceeds that of the last cycle under the first function or when
        the knots move by more than that and further twice in a row.
        """
        if self._rule.choice == "always":
            self._in_use = True
            return
        small = change_m < SETTLED_M and change_rad < SETTLED_RAD
        if not self._in_use:
            self._first_force = force
            self._settled = self._settled + 1 if small else 0
            self._in_use = self._settled >= SETTLED_CYCLES
            self._last_change, self._growing = np.inf, 0
            return
        self._growing = self._growing + 1 if not small and change_m > self._last_change else 0
        self._last_change = change_m
        if force > self._first_force or self._growing >= SETTLED_CYCLES:
            self._in_use, self._settled = False, 0


def largest_n(cycle: Cycle) -> float:
    """Return the largest internal force of a cycle [N]."""
    return float(np.linalg.norm(cycle.force[:, :3], axis=1).max())


ARMS = 2


class CorrectionStore:
    """Store of the corrections (M, 2, 6) `[m, rad]` of the last R cycles.

    Parameters
    ----------
    cycles : int
        R, at least 1.
    commands : int
        M.
    """

    def __init__(self, cycles: int, commands: int) -> None:
        if cycles < 1 or commands < 2:
            raise ConfigError(
                f"correction store: at least 1 cycle and 2 commands are needed, got {cycles} and {commands}"
            )
        self._cycles, self._commands = cycles, commands
        self._kept: list[Floats] = []

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def full(self) -> bool:
        """Return whether R cycles are stored."""
        return len(self._kept) == self._cycles

    @property
    def corrections(self) -> Floats:
        """Return the stored corrections (n, M, 2, 6), oldest first."""
        return np.array(self._kept).reshape(len(self._kept), self._commands, ARMS, 6)

    def add(self, corrections: ArrayLike) -> None:
        """Store one cycle (M, 2, 6): master, slave."""
        values = np.array(corrections, dtype=float)
        if values.shape != (self._commands, ARMS, 6):
            raise ConfigError(f"correction store: a cycle has shape ({self._commands}, {ARMS}, 6), got {values.shape}")
        if not np.isfinite(values).all():
            raise ConfigError("correction store: a cycle with a correction that is not finite cannot be learned from")
        self._kept = [*self._kept, values][-self._cycles :]

    def clear(self) -> None:
        """Delete all cycles, because the errors of a learned block no longer exist."""
        self._kept = []

    def rereference(self, change: ArrayLike) -> None:
        """Subtract the learned change of the commands from the stored corrections.

        Parameters
        ----------
        change : array of shape (M, 2, 6)
            Change of the commands of master and slave by what was learned, base axes.
        """
        for cycle in self._kept:
            cycle -= np.asarray(change, dtype=float)
