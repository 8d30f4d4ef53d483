"""Torque constants that are known to a few percent: a gain per axis beside links and loads (`methods.md` 9).

The measured torque is `(1 + g) tau`, the column of a gain the torque as modelled, so the problem is solved again and
again from where it was solved last until it stays there.
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
    """

    design: Floats
    tau_nm: Floats
    known_nm: Floats
    bodies: int
    gain: Ints

    def torque(self, value: Floats) -> Floats:
        """Modelled torque (r,) [Nm] in the joints, without gains, biases and friction."""
        return self.known_nm + self.design[:, : self.bodies] @ value[: self.bodies]

    def about(self, value: Floats) -> tuple[Floats, Floats]:
        """Design (r, p) and target (r,) of the linear problem about a solution (p,)."""
        gain, torque = value[self.gain], self.torque(value)
        design = self.design.copy()
        design[:, : self.bodies] *= 1.0 + gain[:, None]
        design[np.arange(len(design)), self.gain] = torque
        return design, self.tau_nm - self.known_nm + gain * (torque - self.known_nm)


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
