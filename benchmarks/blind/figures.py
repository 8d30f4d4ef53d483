"""From scored cells to the figures with their intervals, the confusion matrix and the weakest cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import beta

Cell = dict
STRONG = 3.0


def clopper_pearson(hits: float, total: int) -> list[float]:
    """95 % interval of a share (Clopper and Pearson 1934)."""
    if total == 0:
        return [0.0, 1.0]
    low = 0.0 if hits <= 0 else float(beta.ppf(0.025, hits, total - hits + 1))
    high = 1.0 if hits >= total else float(beta.ppf(0.975, hits + 1, total - hits))
    return [low, high]


def bootstrap(values: Sequence[float], statistic: Callable = np.median) -> list[float]:
    """95 % percentile bootstrap interval."""
    if not len(values):
        return [float("nan")] * 2
    rng = np.random.default_rng(0)
    data = np.asarray(values, dtype=float)
    draws = [statistic(data[rng.integers(0, len(data), len(data))]) for _ in range(1000)]
    return [float(v) for v in np.percentile(draws, [2.5, 97.5])]


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
    out: dict[str, dict] = {}

    def share(name: str, hits: Sequence[float], goal: float, least: bool = True) -> None:
        total = len(hits)
        value = float(np.mean(hits)) if total else float("nan")
        met = None if not total else (value >= goal if least else value <= goal)
        out[name] = {
            "value": value,
            "interval": clopper_pearson(float(np.sum(hits)), total),
            "unit": f"of {total} cells",
            "goal": f"{'>=' if least else '<='} {goal:g}",
            "met": met,
        }

    share("right effect, strength >= 3", [credit(c) for c in strong], 0.99)
    share("right effect, strength 1.5 to 3", [credit(c) for c in weak], 0.95)
    share("right effect and axis, strength >= 3", [credit(c, places) for c in strong], 0.98)
    share("false alarm on clean cells", [float(claims(c)) for c in clean], 0.01, least=False)
    share("both named, two effects of strength >= 3", [float(credit(c) == 1.0) for c in two], 0.92)
    called = [float(bool(c["found"]) and c["verdict"] in ("explained", "undecided")) for c in off]
    share("off-library effect called by a library name", called, 0.05, least=False)
    _median(out, "hold-out residual after, over the noise floor", over, 1.1)
    _median(out, "load error after, over that of an estimator given the effect", ratios, 1.2)
    value = float(np.mean(inside)) if inside else float("nan")
    out["95 % intervals hold the truth"] = {
        "value": value,
        "interval": clopper_pearson(float(np.sum(inside)), len(inside)),
        "unit": f"of {len(inside)}",
        "goal": "0.92 .. 0.98",
        "met": 0.92 <= value <= 0.98,
    }
    times = [c["first_s"] for c in cells if np.isfinite(c["first_s"])]
    out["time of diagnose, 40 poses bare and loaded"] = {
        "value": float(np.percentile(times, 95)),
        "interval": [float(np.median(times)), float(np.max(times))],
        "unit": "s (95th percentile; median .. largest)",
        "goal": "<= 2",
        "met": float(np.percentile(times, 95)) <= 2.0,
    }
    return out


def _median(out: dict[str, dict], name: str, values: Sequence[float], goal: float) -> None:
    value = float(np.median(values)) if len(values) else float("nan")
    out[name] = {
        "value": value,
        "interval": bootstrap(values),
        "unit": f"median of {len(values)} cells",
        "goal": f"<= {goal:g}",
        "met": value <= goal,
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
    parts = [
        ("bus: from start to report", [float(c["finished"]) for c in cells], f"of {len(cells)} cells", 1.0),
        ("bus: exactly what is there named", right, f"of {len(cells)} cells", 0.9),
        ("bus: 95 % intervals hold the truth", [float(v) for v in inside], f"of {len(inside)}", 0.85),
    ]
    out: dict[str, dict] = {}
    for name, hits, unit, goal in parts:
        value = float(np.mean(hits)) if hits else float("nan")
        interval = clopper_pearson(float(np.sum(hits)), len(hits))
        met = value >= goal if hits else None
        out[name] = {"value": value, "interval": interval, "unit": unit, "goal": f">= {goal:g}", "met": met}
    out["bus: time of one cell"] = {
        "value": float(np.median(times)),
        "interval": [float(min(times)), float(max(times))],
        "unit": "s (median; shortest .. longest)",
        "goal": "printed",
        "met": True,
    }
    return out


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
