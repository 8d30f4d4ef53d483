"""How often a mistake of commissioning is named, and how often another one is named instead, at three noise levels.

python -m benchmarks.conflict.naming [--seeds 10000:10020] [--mistake NAME]... [--out out/naming]

Arms as in `python -m benchmarks.conflict`; the scatter of the friction band between visits is 2, 4 and 8 %. A mistake
is named where `estimate` or, for mistakes of single joints, `diagnose` reports its check at its joints, or where the
refusal states the unit. Development seeds are 0 to 9999.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.program import one_thread, options, run, seed_range

#: Scatter of the friction band between visits, as a share.
NOISE = (0.02, 0.04, 0.08)


@dataclass(frozen=True, slots=True)
class NamedMistake:
    """Condition, command, and what names it: keys of findings, or words of the message."""

    condition: str
    command: str
    checks: tuple[str, ...] = ()
    words: str = ""


MISTAKES = (
    NamedMistake("torque sign, all", "estimate", ("sign_reversed",)),
    NamedMistake("gravity upside down", "estimate", ("gravity_reversed",)),
    NamedMistake("torque sign, one axis", "estimate", ("sign_reversed",)),
    NamedMistake("joint counted in reverse", "diagnose", ("joint_reversed",)),
    NamedMistake("zero convention", "diagnose", ("zero_convention",)),
    NamedMistake("q3 holds q3 + q2", "diagnose", ("angles_coupled",)),
    NamedMistake("current as torque", "estimate", words="currents in A"),
    NamedMistake("torque of the motors", "estimate", words="of the motors"),
    NamedMistake("torque in mNm", "estimate", words="torque in mNm"),
    NamedMistake("torque in kNm", "estimate", words="kNm"),
    NamedMistake("lengths in mm", "estimate", words="millimetres"),
    NamedMistake("known mass in grams", "estimate", words="grams"),
)
#: Keys that name a mistake of commissioning.
NAMES = frozenset(check for mistake in MISTAKES for check in mistake.checks) | {"axes_swapped", "current_rms_peak"}


def named(task: tuple[int, str, float]) -> dict:
    """Draw one cell with a mistake and type the command: whether it is named, and whether another one is."""
    from benchmarks.conflict.answers import typed
    from benchmarks.conflict.conditions import CONDITIONS
    from benchmarks.conflict.plant import draw_cell, measure

    seed, condition, noise = task
    mistake = next(each for each in MISTAKES if each.condition == condition)
    cell = draw_cell(seed)
    cell.scatter = noise
    CONDITIONS[condition].before(cell)
    cell.columns = measure(cell)
    before = {name: column.copy() for name, column in cell.columns.items()}
    CONDITIONS[condition].after(cell)
    axes = {
        axis
        for axis in range(1, 7)
        if any((cell.columns[name] != before[name]).any() for name in (f"q{axis}_rad", f"tau{axis}_nm"))
    }
    if condition == "q3 holds q3 + q2":
        axes = {2, 3}
    with tempfile.TemporaryDirectory() as folder:
        _, output, result = typed(cell, Path(folder), mistake.command)
    found = {
        (finding["check"], joint)
        for finding in result["findings"]
        if finding.get("check") in NAMES
        for joint in [int(part[1:].rstrip(",")) for part in finding["where"].split() if part[0] == "J"] or [0]
    }
    text = output + " ".join(finding["what"] for finding in result["findings"])
    expected = {(check, axis) for check in mistake.checks for axis in axes or {0}}
    is_named = mistake.words in text if mistake.words else expected <= found
    wrong = bool(found - expected)
    return {"seed": seed, "condition": condition, "noise": noise, "named": is_named, "wrong": wrong}


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/naming", jobs=1)
    parser.add_argument("--seeds", type=seed_range, default="10000:10020", metavar="FIRST:END")
    parser.add_argument("--mistake", action="append", choices=[each.condition for each in MISTAKES])
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.figure import conclude, share

    chosen = arguments.mistake or [each.condition for each in MISTAKES]
    tasks = [(seed, condition, noise) for condition in chosen for noise in NOISE for seed in arguments.seeds]
    answers = run(named, tasks, arguments.jobs, arguments.out / "cells.jsonl")
    figures = {}
    for condition in chosen:
        for noise in NOISE:
            own = [each for each in answers if (each["condition"], each["noise"]) == (condition, noise)]
            figures[f"{condition}, noise {100 * noise:.0f} %: named"] = share([each["named"] for each in own])
    figures["named"] = share([each["named"] for each in answers], ">= 0.95")
    figures["another mistake named"] = share([each["wrong"] for each in answers], "<= 0.01")

    return conclude(figures, arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
