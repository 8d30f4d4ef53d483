"""Effects of the library as columns of a fit in motion: torque in addition to the model without effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.model.motion import Modelled, MovingRows, time_order
from gateway.model.term import Term

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SeenEffects:
    """Effects evaluated on the rows of a fit: `rows` are the rows in the order `order` (n,) of the fit."""

    terms: tuple[Term, ...]
    rows: MovingRows
    order: NDArray[np.int_]

    def without(self, terms: tuple[Term, ...]) -> SeenEffects:
        """Return a copy without some of the effects."""
        return replace(self, terms=tuple(term for term in self.terms if term not in terms))

    @property
    def load(self) -> NDArray[np.str_]:
        """Load (n,) of each row of the fit."""
        return self.rows.load[np.argsort(self.order)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the linear parameters."""
        return tuple(
            f"{' '.join((term.name, *(f'J{joint}' for joint in term.joints)))}: {name}"
            for term in self.terms
            for name in term.parameters[: term.count]
        )

    @property
    def std(self) -> Floats:
        """Standard deviation of the prior of each linear parameter about 0, infinite = free."""
        spread = np.array([value for term in self.terms for value in term.spread[: term.count]], dtype=float)
        return np.where(np.isnan(spread), np.inf, spread)

    def columns(self, modelled: Modelled | None) -> Floats:
        """Columns (n, N, k) of the effects; those that depend on the modelled torque need it as argument."""
        out, start = np.zeros((*self.rows.tau_nm.shape, len(self.std))), 0
        for term in self.terms:
            if term.modelled is (modelled is not None):
                own = term.columns(self.rows, modelled)  # type: ignore[arg-type]
                for place, axis in enumerate(term.enters(self.rows.axes)):
                    out[self.order, axis, start : start + term.count] = own[:, place]
            start += term.count
        return out

    def modelled(self, bodies: Floats, load_kg: Floats, value: Floats) -> Modelled:
        """Torque of bodies (n, 10 N) with the effects (k,), for terms that depend on it; loads with masses (n,)."""
        seen, start = bodies[self.order], 0
        for term in self.terms:
            seen += term.bodies(value[start : start + term.count], bodies.shape[1])
            start += term.count
        rigid_nm = np.einsum("nap,np->na", self.rows.rigid, seen)
        return Modelled(rigid_nm, rigid_nm, seen, load_kg[self.order])


@dataclass(frozen=True, slots=True, eq=False)
class Effects:
    """Effects of a fit, and how to evaluate them on the rows of a table."""

    terms: tuple[Term, ...]
    rows_of: Callable[[Table], MovingRows]

    def of_rows(self, moving: Table) -> SeenEffects:
        """Evaluate the effects on the rows of a table."""
        return SeenEffects(self.terms, self.rows_of(moving), time_order(moving)[0])
