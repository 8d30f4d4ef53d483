"""Effects of the library as columns of a moving fit: further torque beside what every arm has."""

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
    """Effects with the rows of a fit as they see them: `rows` has those of the fit in the order `order` (n,)."""

    terms: tuple[Term, ...]
    rows: MovingRows
    order: NDArray[np.int_]

    def without(self, terms: tuple[Term, ...]) -> SeenEffects:
        """The same without some of the effects."""
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
        """Columns (n, N, k): of effects that hang on the modelled torque where it is given, of the others where not."""
        out, start = np.zeros((*self.rows.tau_nm.shape, len(self.std))), 0
        for term in self.terms:
            if term.modelled is (modelled is not None):
                own = term.columns(self.rows, modelled)  # type: ignore[arg-type]
                for place, axis in enumerate(term.enters(self.rows.axes)):
                    out[self.order, axis, start : start + term.count] = own[:, place]
            start += term.count
        return out

    def modelled(self, bodies: Floats, load_kg: Floats, value: Floats) -> Modelled:
        """Torque of bodies (n, 10 N) with the effects (k,) in them, for terms that hang on it; the load weighs (n,)."""
        seen, start = bodies[self.order], 0
        for term in self.terms:
            seen += term.bodies(value[start : start + term.count], bodies.shape[1])
            start += term.count
        rigid_nm = np.einsum("nap,np->na", self.rows.rigid, seen)
        return Modelled(rigid_nm, rigid_nm, seen, load_kg[self.order])


@dataclass(frozen=True, slots=True, eq=False)
class Effects:
    """Effects that a fit has, and what makes of a table the rows that they are functions of."""

    terms: tuple[Term, ...]
    rows_of: Callable[[Table], MovingRows]

    def of_rows(self, moving: Table) -> SeenEffects:
        """The effects beside the rows of a table."""
        return SeenEffects(self.terms, self.rows_of(moving), time_order(moving)[0])
