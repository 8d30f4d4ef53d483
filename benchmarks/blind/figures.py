"""From scored cells to the figures with their intervals, the confusion matrix and the weakest cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from benchmarks.figure import figure, middle, share

Cell = dict
STRONG = 3.0


def names(cell: Cell, key: str) -> set:
    """Names of true or found effects."""
    return {entry[0] for entry in cell[key]}


def places(cell: Cell, key: str) -> set:
    """Names with joints."""
    return {(entry[0], tuple(entry[1])) for entry in cell[key]}


def credit(cell: Cell, view: Callable = names) -> float:
    """1 for exactly the true effects, a half for a declared set of rivals that holds them."""
    truth, found = view(cell, "truth"), view(cell, "found")
    if truth == found:
        return 1.0
    return 0.5 if cell["verdict"] == "undecided" and truth <= found else 0.0


def claims(cell: Cell) -> bool:
    """Whether anything is claimed: an effect, or structure."""
    return cell["verdict"] != "none_needed" or bool(cell["found"])


def figures(cells: list[Cell]) -> dict[str, dict]:
    """Every figure with value, interval, goal and whether it is met."""
    one = [c for c in cells if c["kind"] == "one"]
    strong = [c for c in one if c["strengths"][0] >= STRONG]
    weak = [c for c in one if c["strengths"][0] < STRONG]
    clean = [c for c in cells if c["kind"] == "clean"]
    two = [c for c in cells if c["kind"] == "two" and min(c["strengths"]) >= STRONG]
    off = [c for c in cells if c["kind"] == "off"]
    inside = [v for c in cells for v in c["inside"] if c["kind"] != "off"]
    ratios = [_ratio(c) for c in cells if c["load_errors"] and c["errors_with_effects"]]
    over = [c["holdout_over_floor"] for c in cells if c["kind"] != "off"]
    called = [float(bool(c["found"]) and c["verdict"] in ("explained", "undecided")) for c in off]
    times = [c["first_s"] for c in cells if np.isfinite(c["first_s"])]
    slowest_s, span_s = float(np.percentile(times, 95)), (float(np.median(times)), float(np.max(times)))
    return {
        "right effect, strength >= 3": share([credit(c) for c in strong], ">= 0.99"),
        "right effect, strength 1.5 to 3": share([credit(c) for c in weak], ">= 0.95"),
        "right effect and axis, strength >= 3": share([credit(c, places) for c in strong], ">= 0.98"),
        "false alarm on clean cells": share([float(claims(c)) for c in clean], "<= 0.01"),
        "both named, two effects of strength >= 3": share([float(credit(c) == 1.0) for c in two], ">= 0.92"),
        "off-library effect called by a library name": share(called, "<= 0.05"),
        "hold-out residual after, over the noise floor": middle(over, "<= 1.1"),
        "load error after, over that of an estimator given the effect": middle(ratios, "<= 1.2"),
        "95 % intervals hold the truth": share(inside, "0.92 .. 0.98"),
        "time of diagnose, 40 poses bare and loaded": figure(
            slowest_s, "<= 2", "s (95th percentile; median .. largest)", span_s
        ),
    }


def _ratio(cell: Cell) -> float:
    after, with_effects = np.array(cell["load_errors"]), np.array(cell["errors_with_effects"])
    return (
        float(np.sqrt(np.mean((after / np.maximum(with_effects, 1e-9)) ** 2))) if np.any(after != with_effects) else 1.0
    )


def bus_figures(cells: list[Cell]) -> dict[str, dict]:
    """Figures of the cells over the bus; none where none were run."""
    if not cells:
        return {}
    right = [float(names(c, "truth") == names(c, "found") and c["finished"]) for c in cells]
    inside = [v for c in cells for v in c["inside"]]
    times = [c["time_s"] for c in cells]
    return {
        "bus: from start to report": share([float(c["finished"]) for c in cells], ">= 1"),
        "bus: exactly what is there named": share(right, ">= 0.9"),
        "bus: 95 % intervals hold the truth": share([float(v) for v in inside], ">= 0.85"),
        "bus: time of one cell": figure(
            float(np.median(times)), unit="s (median; shortest .. longest)", interval=(min(times), max(times))
        ),
    }


def there_and_said(cell: Cell) -> tuple[str, str]:
    """What a cell holds, and what was said of it, with axes."""
    parts = []
    for key in ("truth", "found"):
        named = [f"{name} {'-'.join(f'J{joint}' for joint in joints)}".strip() for name, joints in cell[key]]
        parts.append(" + ".join(named))
    verdict = cell["verdict"]
    said = f"{parts[1]} ({verdict})" if parts[1] else verdict
    return parts[0] or "nothing that counts", said


def weakest(cells: list[Cell]) -> list[tuple[str, str, str, str]]:
    """Cells that were not answered exactly: (seed, what is there, strengths, what was said), the strongest first."""
    rows = []
    for cell in cells:
        off = cell["kind"] == "off"
        wrong = bool(cell["found"]) if off else places(cell, "truth") != places(cell, "found") or _claims_more(cell)
        if wrong:
            size = max(cell["strengths"], default=0.0)
            strengths = ", ".join(f"{value:.1f}" for value in cell["strengths"])
            rows.append((size, (str(cell["seed"]), *_in_order(cell, strengths))))
    return [row for _, row in sorted(rows, key=lambda entry: -entry[0])]


def _in_order(cell: Cell, strengths: str) -> tuple[str, str, str]:
    there, said = there_and_said(cell)
    return there, strengths, said


def _claims_more(cell: Cell) -> bool:
    return cell["kind"] == "clean" and claims(cell)


def confusion(cells: list[Cell]) -> list[tuple[str, str, int]]:
    """(what is there, what was said, how often), most frequent first."""
    counter: Counter = Counter()
    for cell in cells:
        there = " + ".join(sorted(names(cell, "truth"))) or "clean"
        said = " + ".join(sorted(names(cell, "found"))) or cell["verdict"]
        if cell["verdict"] in ("undecided", "improved") and cell["found"]:
            said += f" ({cell['verdict']})"
        counter[(there if cell["kind"] != "two" else "two effects", said if cell["kind"] != "two" else _two(cell))] += 1
    return [(there, said, count) for (there, said), count in sorted(counter.items())]


def _two(cell: Cell) -> str:
    truth, found = names(cell, "truth"), names(cell, "found")
    if cell["verdict"] == "undecided":
        return "undecided, both among them" if truth <= found else "undecided"
    if truth == found:
        return "both"
    if truth < found:
        return "both and more"
    return "one of them" if truth & found else "neither"
