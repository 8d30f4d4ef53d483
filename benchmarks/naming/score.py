"""Scores of answers: names by the strict rule, errors and coverage of the load, processor time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.blind.strict import STRONG, Said, There, kind, misnamed, right, there
from benchmarks.moving.scores import tensor
from benchmarks.naming.answers import Answer
from benchmarks.naming.cells import TRUTH

#: Half width of a 95 % interval, in standard deviations.
HALF_WIDTH: Final = 1.96
#: Places of the parts of a load.
PARTS: Final = {"mass": slice(0, 1), "centre": slice(1, 4), "inertia": slice(4, 10)}
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
    for cell, entry in truth.items():
        answer = answers.get(cell, Answer(cell, (), False, None, None, float("nan")))
        effects = [there(each["names"], each["joints"], each["strength"]) for each in entry["effects"]]
        _add_names(named, entry["kind"], effects, _said(answer))
    found = load_errors({cell: entry for cell, entry in truth.items() if entry["kind"] != "strange"}, answers)
    out = {row: share_text(values) for row, values in named.items()}
    out[ROWS[7]], out[ROWS[8]], out[ROWS[9]] = found.mass_median, found.mass_rms, found.centre_median
    out[ROWS[10]] = share_text(found.inside["mass"] + found.inside["centre"])
    out[ROWS[11]] = median_text([each.time_s for each in answers.values()], "s")
    return out


def print_columns(corner: str, columns: Mapping[str, Mapping[str, str]]) -> None:
    """Print one column per method, as Markdown."""
    print(f"| {corner} |", " | ".join(columns), "|")
    print("|---" * (len(columns) + 1) + "|")
    for row in next(iter(columns.values())):
        print(f"| {row} |", " | ".join(column[row] for column in columns.values()), "|", flush=True)
    print()


@dataclass(frozen=True, slots=True)
class LoadErrors:
    """Errors of the loads of all cells: mass and inertia as shares, centre [m]; `inside` by part of the load.

    The error of an inertia is the largest of its six numbers' over the largest principal inertia.
    """

    mass: list[float]
    centre: list[float]
    inertia: list[float]
    inside: dict[str, list[bool]]

    @property
    def mass_median(self) -> str:
        """Median error of the mass."""
        return median_text([100.0 * value for value in self.mass], "%")

    @property
    def mass_rms(self) -> str:
        """RMS error of the mass."""
        return number_text(float(np.sqrt(np.mean(np.square(self.mass)))) * 100.0 if self.mass else np.nan, "%")

    @property
    def centre_median(self) -> str:
        """Median error of the centre of gravity."""
        return median_text([1e3 * value for value in self.centre], "mm")


def load_errors(truth: Mapping[str, Mapping[str, Any]], answers: Mapping[str, Answer]) -> LoadErrors:
    """Compare the loads that were given with the truth."""
    out = LoadErrors([], [], [], {part: [] for part in PARTS})
    for cell, entry in truth.items():
        answer = answers.get(cell)
        if answer is None or answer.load is None:
            continue
        error = np.array(answer.load) - np.array(entry["load"])[: len(answer.load)]
        out.mass.append(abs(error[0]) / entry["load"][0])
        out.centre.append(float(np.linalg.norm(error[1:4])))
        if len(error) == 10:
            largest = np.linalg.eigvalsh(tensor(entry["load"][4:]))[-1]
            out.inertia.append(float(np.abs(error[4:]).max() / largest))
        if answer.load_std is not None:
            held = np.abs(error) < HALF_WIDTH * np.array(answer.load_std)
            for part, places in PARTS.items():
                out.inside[part] += [bool(ok) for ok in held[places]]
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


def share_text(values: Sequence[bool]) -> str:
    """Share of the values that are true, and how many there are."""
    return f"{100 * np.mean(values):.0f} % of {len(values)}" if values else "-"


def median_text(values: Sequence[float], unit: str) -> str:
    """Median of the values."""
    return number_text(float(np.median(values)) if values else np.nan, unit)


def number_text(value: float, unit: str) -> str:
    """Three digits and the unit."""
    return f"{value:.3g} {unit}" if np.isfinite(value) else "-"
