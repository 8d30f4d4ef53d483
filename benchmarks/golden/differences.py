"""Answers of this version beside the stored ones, per condition and per table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from benchmarks.figure import HALF_WIDTH, print_table
from benchmarks.golden.answers import largest_difference, relative

Answers = dict[str, dict]
COMMANDS = ("estimate", "diagnose")
#: Relative difference of a load or standard deviation that the linear algebra of another processor may make.
TOLERANCE = 1e-5


def print_differences(before: Answers, after: Answers) -> None:
    """Print figures per condition, `before -> after` where an earlier version is given, and what changed."""
    shared = {number: before[number] for number in after if number in before}
    conditions = list(dict.fromkeys(answer["condition"] for answer in after.values()))
    for command in COMMANDS:
        rows = []
        for condition in [*conditions, "all"]:
            new = {n: a for n, a in after.items() if condition in (a["condition"], "all")}
            old = {n: shared[n] for n in new if n in shared}
            row = [_both(figure, old, new, command) for figure in FIGURES.values()]
            rows.append((condition, len(new), *row, *_changes(old, new, command)))
        print_table(("condition", "tables", *FIGURES, "largest change: load", "std"), rows, command)
    print("estimate against diagnose with no effect named: largest relative difference of load and std")
    for condition in conditions:
        now = [a.get("difference") for a in after.values() if a["condition"] == condition]
        print(f"  {condition}: {_largest(now)} in {sum(d is not None for d in now)} tables")
    differences = changes(shared, after)
    print(f"{len(differences)} answers of {len(shared)} tables differ from the stored ones", *differences, sep="\n")


def changes(before: Answers, after: Answers, tolerance: float = TOLERANCE) -> list[str]:
    """Return a line for each answer whose exit code, loads, verdict, effects or findings are others now."""
    lines = []
    for name in after:
        for command in COMMANDS:
            old, new = before.get(name, {}).get(command), after[name].get(command)
            if old is None or new is None:
                continue
            differences = [
                f"{key}: {old[key]} -> {new[key]}"
                for key in ("exit", "verdict", "effects", "findings")
                if old[key] != new[key]
            ]
            size = largest_difference(old, new) or 0.0
            if old["loads"].keys() != new["loads"].keys() or size > tolerance:
                differences.append(f"loads: {_masses(old)} -> {_masses(new)} (largest relative difference {size:.1e})")
            if differences:
                lines.append(f"{name} {command}: {'; '.join(differences)}")
    return lines


def _masses(answer: dict) -> str:
    pairs = [(label, load["value"][0], load["std"][0]) for label, load in answer["loads"].items()]
    return ", ".join(f"{label} {mass if mass is None else f'{mass:.5g} ± {std:.2g} kg'}" for label, mass, std in pairs)


def coverage(answers: Iterable[dict], command: str) -> str:
    """Share of 95 % intervals of mass and centre that hold the truth."""
    hits = [
        abs(value - true) <= HALF_WIDTH * std
        for value, std, true in _values(answers, command)
        if std is not None and value is not None
    ]
    return f"{100 * np.mean(hits):.1f} %" if hits else "-"


def mass_error(answers: Iterable[dict], command: str) -> str:
    """Median and root mean square of the relative error of the mass."""
    error = [abs(load["value"][0] / true[0] - 1.0) for load, true in _loads(answers, command) if _known(load)]
    return f"{100 * np.median(error):.2f} / {100 * _rms(error):.2f} %" if error else "-"


def centre_error(answers: Iterable[dict], command: str) -> str:
    """Median distance of the centre of gravity."""
    error = [
        np.linalg.norm(np.array(load["value"][1:]) - true[1:])
        for load, true in _loads(answers, command)
        if None not in load["value"]
    ]
    return f"{1000 * np.median(error):.2f} mm" if error else "-"


def width(answers: Iterable[dict], command: str) -> str:
    """Median standard deviation of the mass over the mass."""
    std = [load["std"][0] / true[0] for load, true in _loads(answers, command) if load["std"][0] is not None]
    return f"{100 * np.median(std):.2f} %" if std else "-"


def refused(answers: Iterable[dict], command: str) -> str:
    """Tables and loads that were refused."""
    commands = [answer[command] for answer in answers]
    loads = sum(load["refused"] for entry in commands for load in entry["loads"].values())
    return f"{sum(entry['exit'] not in (0, 7) for entry in commands)}, {loads}"


def naming(answers: Iterable[dict], command: str) -> str:
    """Tables in which exactly what is there is named, and in which something is named that is not there."""
    parts = [answer[command] for answer in answers if "right" in answer[command]]
    return f"{sum(p['right'] for p in parts)}, {sum(p['misnamed'] for p in parts)} of {len(parts)}" if parts else "-"


def cpu_time(answers: Iterable[dict], command: str) -> str:
    """Median and largest processor time."""
    times = [answer[command]["time_s"] for answer in answers]
    return f"{np.median(times):.2f} / {max(times):.2f} s" if times else "-"


FIGURES: dict[str, Callable[[Iterable[dict], str], str]] = {
    "95 % hold": coverage,
    "mass, median / rms": mass_error,
    "centre": centre_error,
    "std of mass": width,
    "refused tables, loads": refused,
    "right, misnamed": naming,
    "time, median / largest": cpu_time,
}


def _loads(answers: Iterable[dict], command: str) -> list[tuple[dict, list[float]]]:
    out = []
    for answer in answers:
        found = answer[command].get("loads", {})
        out += [(found[label], true) for label, true in answer["truth"].items() if label in found]
    return out


def _values(answers: Iterable[dict], command: str) -> list[tuple[float | None, float | None, float]]:
    return [
        values
        for load, true in _loads(answers, command)
        for values in zip(load["value"], load["std"], true, strict=True)
    ]


def _known(load: dict) -> bool:
    return load["value"][0] is not None


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _both(figure: Callable[[Iterable[dict], str], str], old: Answers, new: Answers, command: str) -> str:
    now = figure(list(new.values()), command)
    was = figure(list(old.values()), command) if old else now
    return now if was == now else f"{was} -> {now}"


def _changes(old: Answers, new: Answers, command: str) -> tuple[str, str]:
    """Largest relative change of a load and of a standard deviation."""
    out = []
    for key in ("value", "std"):
        worst: list[float | None] = []
        for number, answer in old.items():
            was, now = answer[command].get("loads", {}), new[number][command].get("loads", {})
            for label in was.keys() & now.keys():
                worst += relative(was[label][key], now[label][key])
        out.append(_largest(worst))
    return out[0], out[1]


def _largest(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{max(known):.1e}" if known else "-"
