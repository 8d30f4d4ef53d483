"""From scored cells of nature to the figures with their intervals, per condition and in all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from benchmarks.blind.figures import Cell
from benchmarks.blind.mechanisms import MECHANISMS
from benchmarks.blind.scores import Scores
from benchmarks.blind.strict import LEAST, STRONG, There, kind, there
from benchmarks.figure import Figures, figure, middle, share
from benchmarks.nature.levels import CONDITIONS

QUANTITIES = ("mass", "x", "y", "z")
METHODS = {"estimated": "estimate", "diagnosed": "diagnose"}
#: Outlier visits that have to be found, in bands.
LARGE_BANDS = 4.0
#: Strength of an effect outside the library that a formula should describe, and what it may leave, in noise floors.
DESCRIBED, AT_NOISE = 5.0, 1.5
#: Log likelihood ratio from which data suffice for a name: odds of 20 against each of 75 other places.
SUFFICIENT = 7.3


def truth(cell: Cell) -> tuple[There, ...]:
    """What is there, by the table of right names."""
    return tuple(there(MECHANISMS[name], joints, size) for name, joints, size in cell["truth"])


NATURE = Scores(truth)


def covered(cells: Iterable[Cell], method: str, quantity: int | None = None) -> list[float]:
    """Whether intervals hold the truth, of one quantity or of all four; those that were not given are left out."""
    which = slice(None) if quantity is None else slice(quantity, quantity + 1)
    values = [value for cell in cells if cell[method] for value in cell[method]["inside"][which]]
    return [value for value in values if np.isfinite(value)]


def widths(cells: Iterable[Cell], method: str) -> list[float]:
    """Widths over the oracle's, all four quantities."""
    return [value for cell in cells if cell[method] for value in cell[method]["width"]]


def nuisance_figures(cells: Sequence[Cell]) -> Figures:
    """Figures of the cells with nothing beyond nuisances, pooled and by condition."""
    out: Figures = {}
    good = [cell for cell in cells if not cell["misstated"]]
    wrong = [cell for cell in cells if cell["misstated"]]
    for method, word in METHODS.items():
        for number, name in enumerate(QUANTITIES):
            out[f"{word}: 95 % interval holds {name}"] = share(covered(good, method, number), "0.93 .. 0.97")
        out[f"{word}: 95 % intervals hold the truth, all four"] = share(covered(good, method), "0.93 .. 0.97")
        out[f"{word}: 95 % intervals hold the truth, priors misstated"] = share(covered(wrong, method))
        out[f"{word}: width over the oracle's"] = middle(widths(good, method), "<= 1.15")
        out[f"{word}: refused"] = share([_refused(cell, word) for cell in cells])
    asked = [cell for cell in cells if cell["verdict"]]
    stated = [cell for cell in asked if not cell["misstated"]]
    out["something named where only nuisances are there"] = share(_named(stated), "<= 0.02")
    out["something named, priors misstated"] = share(_named([cell for cell in asked if cell["misstated"]]))
    out["formula where only nuisances are there"] = share([float(bool(cell["formula"])) for cell in stated], "<= 0.02")
    verdicts = ("none_needed", "explained", "improved")
    out["structure or uncertainty without a name"] = share(
        [float(not cell["found"] and cell["verdict"] not in verdicts) for cell in asked]
    )
    for condition in CONDITIONS:
        here = [cell for cell in good if cell["condition"] == condition]
        out |= {f"{condition}: {name}": entry for name, entry in _of_condition(here).items()}
    return out


def _of_condition(cells: Sequence[Cell]) -> Figures:
    out: Figures = {}
    for method, word in METHODS.items():
        for number, name in enumerate(QUANTITIES):
            out[f"{word} holds {name}"] = share(covered(cells, method, number), ">= 0.9")
        out[f"{word}, width over the oracle's"] = middle(widths(cells, method))
    out["something named"] = share(_named([cell for cell in cells if cell["verdict"]]), "<= 0.05")
    return out


def _named(cells: Iterable[Cell]) -> list[float]:
    return [float(bool(cell["found"])) for cell in cells]


def _refused(cell: Cell, word: str) -> float:
    return float(any(text.startswith(word) for text in cell["refused"]))


def effect_figures(cells: Sequence[Cell]) -> Figures:
    """Figures of the cells with something beyond nuisances."""
    named = [cell for cell in cells if cell["kind"] in ("one", "several") and not cell["misstated"]]
    misstated = [cell for cell in cells if cell["kind"] in ("one", "several") and cell["misstated"]]
    strange = [cell for cell in cells if cell["kind"] == "strange"]
    by_kind = NATURE.by_kind(named)
    strong = NATURE.all_strong(by_kind["several"])
    clear = [cell for cell in by_kind["several"] if min(cell["beside"]) >= STRONG]
    wired = [cell for cell in cells if cell["kind"] == "wiring"]
    off = [cell for cell in strange if _size(cell) >= LEAST]
    loads = [cell for cell in named if not any(name == "slipping_load" for name, _, _ in cell["truth"])]
    return {
        f"right, one effect of strength >= {STRONG:g}": share(NATURE.right(by_kind["strong"]), ">= 0.97"),
        f"right, one effect of strength {LEAST:g} to {STRONG:g}": share(NATURE.right(by_kind["weak"]), ">= 0.9"),
        f"right, two or more effects, each of strength >= {LEAST:g}": share(NATURE.right(by_kind["several"]), ">= 0.9"),
        f"right, two or more effects, each of strength >= {STRONG:g}": share(NATURE.right(strong), ">= 0.9"),
        f"right, two or more effects, each of strength >= {STRONG:g} beyond the others too": share(NATURE.right(clear)),
        f"right or without a name, below {LEAST:g}": share(
            [1.0 - value for value in NATURE.misnamed(by_kind["below"])]
        ),
        "right, priors misstated": share(NATURE.right([c for c in misstated if kind(truth(c)) != "below"])),
        "wrong, one effect with sufficient data": share(_wrong_on_sufficient_data(named, "one"), "<= 0.03"),
        "wrong, two or more effects with sufficient data": share(
            _wrong_on_sufficient_data(named, "several"), "<= 0.03"
        ),
        "something named that is not there": share(NATURE.misnamed(named)),
        "off-library given a library name": share(NATURE.misnamed(off), "<= 0.05"),
        f"off-library given a library name, below {LEAST:g}": share(
            NATURE.misnamed([cell for cell in strange if _size(cell) < LEAST])
        ),
        f"off-library of strength >= {DESCRIBED:g}: formula, left-out poses at the noise floor": share(
            [float(cell["formula_left"] < AT_NOISE) for cell in strange if _size(cell) >= DESCRIBED], ">= 0.6"
        ),
        "wiring mistakes named": share(NATURE.right(wired)),
        "beyond nuisances: 95 % intervals hold the truth": share(covered(loads, "diagnosed")),
        "beyond nuisances: width over the oracle's": middle(widths(named, "diagnosed"), "<= 1.15"),
        "beyond nuisances: refused": share([float(bool(cell["refused"])) for cell in cells]),
    }


def _wrong_on_sufficient_data(cells: Sequence[Cell], kind_: str) -> list[float]:
    """Whether names are wrong although the data suffice, of the cells with an effect of enough strength."""
    asked = [cell for cell in cells if cell["kind"] == kind_ and _size(cell) >= LEAST]
    return [
        float(not right and all(ratio >= SUFFICIENT for ratio in _required(cell)))
        for cell, right in zip(asked, NATURE.right(asked), strict=True)
    ]


def _required(cell: Cell) -> list[float]:
    return [ratio for (_, _, size), ratio in zip(cell["truth"], cell["log_ratios"], strict=True) if size >= LEAST]


def _size(cell: Cell) -> float:
    return max(size for _, _, size in cell["truth"])


def outlier_figures(cells: Sequence[Cell]) -> Figures:
    """Outlier visits found, and good ones thrown out, of all cells that were diagnosed."""
    asked = [cell for cell in cells if cell["verdict"] and cell["kind"] != "wiring"]
    found = [value for cell in asked for value in _found(cell)]
    thrown = [value for cell in asked for value in _thrown(cell)]
    return {
        f"outlier visits of {LARGE_BANDS:g} bands and more found": share(found, ">= 0.95"),
        "good visits thrown out": share(thrown, "<= 0.01"),
    }


def _found(cell: Cell) -> list[float]:
    rejected = {(pose, load, joint) for pose, load, joint, _ in cell["set_aside"]}
    return [
        float((pose, load, joint) in rejected) for pose, load, joint, bands in cell["outliers"] if bands >= LARGE_BANDS
    ]


def _thrown(cell: Cell) -> list[float]:
    """Whether a visit that went well was rejected on any axis; of visits of one pose and load, once."""
    outliers = {(pose, load) for pose, load, _, _ in cell["outliers"]}
    rejected = {(pose, load) for pose, load, _, _ in cell["set_aside"]}
    return [float((pose, load) in rejected) for pose, load in {(p, name) for p, name in cell["visits"]} - outliers]


def time_figures(timed: Sequence[Cell]) -> Figures:
    """Median and largest time of a diagnosis."""
    times = [cell["time_s"] for cell in timed]
    if not times:
        return {}
    span = [float(min(times)), float(max(times))]
    parts = (("median", float(np.median(times)), "<= 2"), ("largest", span[1], "<= 4"))
    return {
        f"time of diagnose, 40 poses bare and loaded, {word}": figure(value, goal, f"s of {len(times)}", span)
        for word, value, goal in parts
    }


def confusion(cells: Sequence[Cell]) -> list[tuple[str, str, int]]:
    """(what is there, what was said, how often) of the cells with one effect, strange ones and wiring mistakes."""
    counter: Counter = Counter()
    for cell in cells:
        if len(cell["truth"]) == 1:
            name, _, size = cell["truth"][0]
            mark = "" if size >= STRONG else " (weak)" if size >= LEAST else " (below)"
            counter[(name + mark, _words(cell))] += 1
    return [(name, words, count) for (name, words), count in sorted(counter.items())]


def _words(cell: Cell) -> str:
    if NATURE.is_right(cell):
        return "right"
    names = " + ".join(sorted({name for name, _ in cell["found"]}))
    return f"{names} ({cell['verdict']})" if names else str(cell["verdict"] or "refused")


def falsely_named(cells: Sequence[Cell]) -> list[tuple[str, str, int]]:
    """(condition, what was named, how often) of the cells with only nuisances."""
    counter = Counter((cell["condition"], _words(cell)) for cell in cells if cell["found"])
    return [(condition, words, count) for (condition, words), count in sorted(counter.items())]


def by_condition(cells: Sequence[Cell]) -> list[list[str]]:
    """Rows of a table, a condition each.

    How many were estimated and diagnosed, coverage of the four and width by both methods, named, outlier visits found,
    good ones thrown out.
    """
    rows = []
    parts: list[tuple[str, Callable[[Cell], bool]]] = [("pooled", lambda cell: not cell["misstated"])]
    parts += [(name, lambda cell, name=name: cell["condition"] == name) for name in CONDITIONS]
    for name, chosen in parts:
        here = [cell for cell in cells if chosen(cell) and not cell["misstated"]]
        if not here:
            continue
        asked = [cell for cell in here if cell["verdict"]]
        row = [name, f"{len(here)}, {len(asked)}"]
        for method in METHODS:
            shares = [covered(here, method, number) for number in range(4)]
            row.append(" ".join(_percent(values) for values in shares))
            row.append(f"{middle(widths(here, method))['value']:.2f}")
        row.append(_percent(_named(asked)))
        row += [_percent([v for cell in asked for v in count(cell)]) for count in (_found, _thrown)]
        rows.append(row)
    return rows


def _percent(values: Sequence[float]) -> str:
    return f"{100.0 * float(np.mean(values)):.1f}" if values else "-"
