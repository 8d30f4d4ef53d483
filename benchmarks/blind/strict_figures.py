"""The tier of the simulator's own draws under strict scoring, strengths beyond nuisance parameters."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.blind.figures import Cell
from benchmarks.blind.scores import Scores
from benchmarks.blind.strict import LEAST, STRONG, There, there
from benchmarks.figure import Figures, share

MISTAKES = ("sign_reversed", "axes_swapped", "current_rms_peak")


def truth(cell: Cell) -> tuple[There, ...]:
    """What is there; of several forms of one effect, the name that the program has for it."""
    return tuple(there((name,), joints, size) for name, joints, size in cell["beyond"])


STRICT = Scores(truth)


def strict_figures(cells: Sequence[Cell]) -> Figures:
    """Strict figures; a mistake of commissioning and what is outside the library are counted apart."""
    wired = [cell for cell in cells if any(name in MISTAKES for name, _, _ in cell["beyond"])]
    drawn = {id(cell) for cell in wired}
    off = [c for c in cells if c["kind"] == "off" and any(effect.counts for effect in truth(c))]
    plain = [cell for cell in cells if id(cell) not in drawn and cell["kind"] != "off" and cell["beyond"]]
    by_kind = STRICT.by_kind(plain)
    strong, below = STRICT.all_strong(by_kind["several"]), STRICT.misnamed(by_kind["below"])
    return {
        f"strict: right, one effect of strength >= {STRONG:g}": share(STRICT.right(by_kind["strong"]), ">= 0.979"),
        f"strict: right, one effect of strength {LEAST:g} to {STRONG:g}": share(STRICT.right(by_kind["weak"])),
        f"strict: right, two effects, each of strength >= {STRONG:g}": share(STRICT.right(strong), ">= 0.926"),
        f"strict: right, two effects, each of strength >= {LEAST:g}": share(STRICT.right(by_kind["several"])),
        f"strict: right or without a name, below {LEAST:g}": share([1.0 - value for value in below]),
        "strict: something named that is not there": share(STRICT.misnamed([*plain, *off])),
        "strict: off-library given a library name": share(STRICT.misnamed(off), "<= 0.05"),
        "strict: wiring mistakes named": share(STRICT.right(wired)),
        "strict: something named where nothing is": share(
            [float(bool(cell["found"])) for cell in cells if not cell["beyond"]], "<= 0.02"
        ),
    }
