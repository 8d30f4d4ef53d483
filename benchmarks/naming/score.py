"""Scores of answers: names by the strict rule, errors and coverage of the load, processor time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.naming.answers import Answer
from benchmarks.naming.cells import TRUTH
from tests.support.blind.strict import STRONG, Said, There, kind, misnamed, right, there

#: Half width of a 95 % interval, in standard deviations.
HALF_WIDTH: Final = 1.96
ROWS: Final = (
    "one effect of strength 3 and more: named exactly",
    "one effect of strength 1.5 to 3",
    "two or three effects, each of 1.5 and more",
    "the same, each of 3 and more",
    "no effect: something named",
    "effect outside the library: library name given",
    "something named that is not there, all cells",
    "mass: median error",
    "mass: rms error",
    "centre of gravity: median error",
    "95 % intervals of mass and centre that hold",
    "processor time per cell, median",
)


def read_truth(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the truth by cell."""
    lines = (folder / TRUTH).read_text(encoding="utf-8").splitlines()
    return {entry["cell"]: entry for entry in map(json.loads, lines)}


def scores(truth: Mapping[str, Mapping[str, Any]], answers: Mapping[str, Answer]) -> dict[str, str]:
    """Return the text of each row of the table; a cell without an answer counts as one without names and load."""
    named: dict[str, list[bool]] = {row: [] for row in ROWS[:7]}
    mass: list[float] = []
    centre: list[float] = []
    inside: list[bool] = []
    for cell, entry in truth.items():
        answer = answers.get(cell, Answer(cell, (), False, None, None, float("nan")))
        effects = [there(each["names"], each["joints"], each["strength"]) for each in entry["effects"]]
        _add_names(named, entry["kind"], effects, _said(answer))
        if answer.load is not None and entry["kind"] != "strange":
            error = np.array(answer.load) - np.array(entry["load"])
            mass.append(abs(error[0]) / entry["load"][0])
            centre.append(float(np.linalg.norm(error[1:])))
            if answer.load_std is not None:
                inside += [bool(ok) for ok in np.abs(error) < HALF_WIDTH * np.array(answer.load_std)]
    out = {row: _share(values) for row, values in named.items()}
    out[ROWS[7]] = _number(np.median(mass) * 100 if mass else np.nan, "%")
    out[ROWS[8]] = _number(np.sqrt(np.mean(np.square(mass))) * 100 if mass else np.nan, "%")
    out[ROWS[9]] = _number(np.median(centre) * 1e3 if centre else np.nan, "mm")
    out[ROWS[10]] = _share(inside)
    out[ROWS[11]] = _number(float(np.median([each.time_s for each in answers.values()])), "s")
    return out


def _said(answer: Answer) -> Said:
    verdict = "undecided" if answer.undecided else "explained" if answer.named else "none_needed"
    return Said(answer.named, verdict)


def _add_names(named: Mapping[str, list[bool]], cell_kind: str, effects: Sequence[There], said: Said) -> None:
    wrong = misnamed(effects, said) if cell_kind != "clean" else bool(said.found)
    named[ROWS[6]].append(wrong)
    if cell_kind == "clean":
        named[ROWS[4]].append(bool(said.found))
    elif cell_kind == "strange":
        named[ROWS[5]].append(bool(said.found))
    else:
        size = kind(effects)
        row = {"strong": ROWS[0], "weak": ROWS[1], "several": ROWS[2]}.get(size)
        if row is not None:
            named[row].append(right(effects, said))
        if size == "several" and all(each.strength >= STRONG for each in effects if each.counts):
            named[ROWS[3]].append(right(effects, said))


def _share(values: Sequence[bool]) -> str:
    return f"{100 * np.mean(values):.0f} % of {len(values)}" if values else "-"


def _number(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if np.isfinite(value) else "-"
