"""The tier of the simulator's own draws under strict scoring, strengths beyond what every arm has."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.blind.shares import Figures, share
from benchmarks.blind.strict import LEAST, STRONG, Said, There, kind, misnamed, right, there

Cell = dict

MISTAKES = ("sign_reversed", "axes_swapped", "current_rms_peak")


def truth(cell: Cell) -> tuple[There, ...]:
    """What is there; of several forms of one effect, the name that the program has for it."""
    return tuple(there((name,), joints, size) for name, joints, size in cell["beyond"])


def said(cell: Cell) -> Said:
    """What was said."""
    return Said(tuple((name, tuple(joints)) for name, joints in cell["found"]), cell["verdict"])


def strict_figures(cells: Sequence[Cell]) -> Figures:
    """Strict figures; a mistake of commissioning and what is outside the library are counted apart."""
    wired = [cell for cell in cells if any(name in MISTAKES for name, _, _ in cell["beyond"])]
    drawn = {id(cell) for cell in wired}
    off = [c for c in cells if c["kind"] == "off" and any(effect.counts for effect in truth(c))]
    plain = [cell for cell in cells if id(cell) not in drawn and cell["kind"] != "off" and cell["beyond"]]
    by_kind: dict[str, list[Cell]] = {"strong": [], "weak": [], "several": [], "below": []}
    for cell in plain:
        by_kind[kind(truth(cell))].append(cell)
    strong = [cell for cell in by_kind["several"] if all(t.strength >= STRONG for t in truth(cell) if t.counts)]
    return {
        f"strict: right, one effect of strength >= {STRONG:g}": share(_right(by_kind["strong"]), ">= 0.979"),
        f"strict: right, one effect of strength {LEAST:g} to {STRONG:g}": share(_right(by_kind["weak"])),
        f"strict: right, two effects, each of strength >= {STRONG:g}": share(_right(strong), ">= 0.926"),
        f"strict: right, two effects, each of strength >= {LEAST:g}": share(_right(by_kind["several"])),
        f"strict: right or silent, below {LEAST:g}": share(
            [float(not misnamed(truth(cell), said(cell))) for cell in by_kind["below"]]
        ),
        "strict: something named that is not there": share(_misnamed([*plain, *off])),
        "strict: off-library given a library name": share(_misnamed(off), "<= 0.05"),
        "strict: wiring mistakes named": share(_right(wired)),
        "strict: something named where nothing is": share(
            [float(bool(cell["found"])) for cell in cells if not cell["beyond"]], "<= 0.02"
        ),
    }


def _right(cells: Iterable[Cell]) -> list[float]:
    return [float(right(truth(cell), said(cell))) for cell in cells]


def _misnamed(cells: Iterable[Cell]) -> list[float]:
    return [float(misnamed(truth(cell), said(cell))) for cell in cells]
