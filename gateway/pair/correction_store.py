"""Corrections of the newest cycles, for every command of the path and both arms (CN104379308, blocks 111a, 111b)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats

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
