"""Shares per condition, per check and pooled, with their goals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from benchmarks.conflict.answers import DEFECT, FAR
from benchmarks.conflict.conditions import CONDITIONS
from benchmarks.figure import Figures, middle, share

#: Median standard deviation of the mass on clean cells that may be reached, over the true mass.
CLEAN_STD = 1.25 * 0.0159
FALSE_ALARMS = {"clean": "<= 0.02", "clean, nature": "<= 0.03", "known mass": "<= 0.02"}
UNREPORTED = "<= 0.01"


def checks(answer: dict) -> set[str]:
    """Checks that warn or fail."""
    return {check for severity, check, *_ in answer["findings"] if severity in ("warn", "fail")}


def refused(answer: dict) -> bool:
    """No load is given."""
    return answer["exit"] != DEFECT and all(load["off"] is None for load in answer["loads"])


def warned(answer: dict) -> bool:
    """Return whether an engineer is warned: by a warning, a failing finding or a refusal."""
    return bool(checks(answer)) or answer["exit"] not in (0, DEFECT) or refused(answer)


def false_alarm(answer: dict) -> bool:
    """Whether a right cell is warned of; rejecting visits is right where visits are far off."""
    found = [where for severity, _, where, _ in answer["findings"] if severity in ("warn", "fail")]
    return answer["exit"] != 0 or any(where != "outliers" or not answer["outliers"] for where in found)


def is_unreported(answer: dict) -> bool:
    """A mass is wrong by more than three stated standard deviations, or nothing came back, and nothing is said."""
    far = answer["exit"] == DEFECT or any((load["off"] or 0.0) > FAR for load in answer["loads"])
    return far and not warned(answer)


def given_loads(answers: Iterable[dict]) -> list[dict]:
    """Loads with a mass."""
    return [load for answer in answers for load in answer["loads"] if load["off"] is not None]


def figures(answers: Sequence[dict]) -> Figures:
    """Every figure of the benchmark, in the order of the conditions."""
    out: Figures = {}
    for variant in dict.fromkeys(answer["variant"] for answer in answers):
        of_variant = [answer for answer in answers if answer["variant"] == variant]
        for name in (name for name in CONDITIONS if any(a["condition"] == name for a in of_variant)):
            out |= _of_condition(name, variant, [a for a in of_variant if a["condition"] == name])
    out["defects of the program"] = share([answer["exit"] == DEFECT for answer in answers], "<= 0")
    return out


def _of_condition(name: str, variant: str, answers: Sequence[dict]) -> Figures:
    of, loads = f"{name} ({variant})", given_loads(answers)
    out = {f"{of}: unreported": share([is_unreported(a) for a in answers], UNREPORTED)}
    if CONDITIONS[name].clean:
        goal = FALSE_ALARMS[name] if variant == "floor" else "printed"
        out[f"{of}: warned"] = share([false_alarm(a) for a in answers], goal)
        limit = f"<= {CLEAN_STD:.4f}" if (name, variant) == ("clean", "floor") else "printed"
        out[f"{of}: std of mass"] = middle([load["std"] for load in loads], limit)
    else:
        out[f"{of}: warned or refused"] = share([warned(a) for a in answers])
    return out


def condition_rows(answers: Sequence[dict]) -> list[list[str]]:
    """Condition, variant, cells, unreported errors, detection, refusals, error, rms, stated std and time of each."""
    rows = []
    for name, variant in dict.fromkeys((a["condition"], a["variant"]) for a in answers):
        these = [a for a in answers if (a["condition"], a["variant"]) == (name, variant)]
        loads = given_loads(these)
        error = [load["error"] for load in loads]
        row = [
            name,
            variant,
            str(len(these)),
            str(sum(map(is_unreported, these))),
            _percent([(false_alarm if CONDITIONS[name].clean else warned)(a) for a in these]),
            _percent([refused(a) for a in these]),
            _percent(error, 1),
            _percent([(sum(e * e for e in error) / len(error)) ** 0.5] if error else [], 1),
            _percent(sorted(load["std"] for load in loads)[len(loads) // 2 :][:1], 2),
            f"{sum(a['time_s'] for a in these) / len(these):.2f}",
        ]
        rows.append(row)
    return rows


def check_rates(answers: Sequence[dict]) -> list[tuple[str, float, float, str]]:
    """Check, share of clean cells and of the other cells in which it fires, and where it fires most."""
    clean = [answer for answer in answers if CONDITIONS[answer["condition"]].clean]
    wrong = [answer for answer in answers if not CONDITIONS[answer["condition"]].clean]
    cells = Counter(answer["condition"] for answer in answers)
    rows = []
    for check in sorted({check for answer in answers for check in checks(answer)}):
        where = Counter(answer["condition"] for answer in wrong if check in checks(answer))
        most = sorted(where, key=lambda name: -where[name] / cells[name])[:4]
        text = ", ".join(f"{name} {100 * where[name] / cells[name]:.0f} %" for name in most)
        alarms = sum(check in checks(answer) for answer in clean) / max(len(clean), 1)
        rows.append((check, alarms, sum(where.values()) / max(len(wrong), 1), text))
    return sorted(rows, key=lambda row: -row[2])


def check_table(answers: Sequence[dict]) -> str:
    """`check_rates` as a table in Markdown."""
    lines = ["| check | clean cells | wrong cells | detects most often |", "|---|---|---|---|"]
    lines += [f"| {name} | {100 * a:.1f} % | {100 * b:.1f} % | {most} |" for name, a, b, most in check_rates(answers)]
    return "\n".join(lines)


def _percent(values: Sequence[float], digits: int = 0) -> str:
    return f"{100 * sum(values) / len(values):.{digits}f} %" if values else "-"
