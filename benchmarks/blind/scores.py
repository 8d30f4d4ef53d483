"""Strict scores of the cells of a tier: how many are right, how many named what is not there, by how strong it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from benchmarks.blind.figures import Cell
from benchmarks.blind.strict import STRONG, Said, There, kind, misnamed, right


def said(cell: Cell) -> Said:
    """What was said."""
    return Said(tuple((name, tuple(joints)) for name, joints in cell["found"]), cell["verdict"])


@dataclass(frozen=True, slots=True)
class Scores:
    """Strict scores of cells, of which `truth` lists the effects present."""

    truth: Callable[[Cell], tuple[There, ...]]

    def is_right(self, cell: Cell) -> bool:
        """Whether exactly what is there is named."""
        return right(self.truth(cell), said(cell))

    def right(self, cells: Iterable[Cell]) -> list[float]:
        """1 for every cell of which exactly what is there is named."""
        return [float(self.is_right(cell)) for cell in cells]

    def misnamed(self, cells: Iterable[Cell]) -> list[float]:
        """1 for every cell of which something is named that is not there."""
        return [float(misnamed(self.truth(cell), said(cell))) for cell in cells]

    def by_kind(self, cells: Iterable[Cell]) -> dict[str, list[Cell]]:
        """Cells with one strong effect, with one weak, with several, and with none that counts."""
        out: dict[str, list[Cell]] = {"strong": [], "weak": [], "several": [], "below": []}
        for cell in cells:
            out[kind(self.truth(cell))].append(cell)
        return out

    def all_strong(self, cells: Iterable[Cell]) -> list[Cell]:
        """Those of which all effects that count are strong."""
        return [cell for cell in cells if all(t.strength >= STRONG for t in self.truth(cell) if t.counts)]
