"""Gains of the torque constants and load friction of one-sided approaches, beside links and loads (`methods.md` 9).

The measured torque is `(1 + g) tau + d nu |tau|`, with the direction d of a one-sided approach, 0 where both sides were
measured: in half-sums load friction cancels. The columns of g and nu hold the torque as modelled, so the problem is
solved again from the last solution until it no longer changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.solve import Prior, solve

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

_STEPS: Final = 12
_SETTLED: Final = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class GainRows:
    """Rows of which the first `bodies` columns are torque that a gain multiplies, as the known torque.

    Attributes
    ----------
    design : array of shape (r, p)
        At gain 0; the columns of the gains are 0.
    tau_nm, known_nm : arrays of shape (r,)
        Measured torque, and what of the true one is known.
    bodies : int
    gain : int array of shape (r,)
        Column of the gain of each row.
    loss : int array of shape (r,), optional
        Column of the load friction of each row; where `direction` is 0 it is not used.
    direction : array of shape (r,), optional
        Direction of the approach of a one-sided row, else 0.
    """

    design: Floats
    tau_nm: Floats
    known_nm: Floats
    bodies: int
    gain: Ints
    loss: Ints | None = None
    direction: Floats | None = None

    def torque(self, value: Floats) -> Floats:
        """Modelled torque (r,) [Nm] in the joints, without gains, biases and friction."""
        return self.known_nm + self.design[:, : self.bodies] @ value[: self.bodies]

    def about(self, value: Floats) -> tuple[Floats, Floats]:
        """Design (r, p) and target (r,) of the linear problem about a solution (p,)."""
        torque = self.torque(value)
        factor, row = value[self.gain], np.arange(len(self.design))
        design = self.design.copy()
        design[row, self.gain] = torque
        if self.loss is not None and self.direction is not None:
            sided = self.direction != 0.0
            factor = factor + np.where(sided, value[self.loss] * self.direction * np.sign(torque), 0.0)
            design[row[sided], self.loss[sided]] = (self.direction * np.abs(torque))[sided]
        design[:, : self.bodies] *= 1.0 + factor[:, None]
        return design, self.tau_nm - self.known_nm + factor * (torque - self.known_nm)


def settled(rows: GainRows, weight: Floats, prior: Prior, start: Floats) -> Floats:
    """Solution (p,) under fixed weights (r,), by Gauss and Newton from `start` (p,)."""
    value = start
    for _ in range(_STEPS):
        design, target = rows.about(value)
        solution = solve(design, target, weight, prior)
        moved = np.abs(solution.value - value) * solution.scale
        value = solution.value
        if moved.max(initial=0.0) <= _SETTLED * max(np.abs(value * solution.scale).max(initial=0.0), 1.0):
            break
    return value
