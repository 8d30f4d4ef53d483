"""How often wrong statements about an arm pass silently, and right ones raise an alarm.

python -m benchmarks.conflict [--seeds 0:40] [--clean N] [--condition NAME]... [--variant NAME]... [--command diagnose]

Random arms of 3 to 200 kg rated load, measured bare and loaded, handed to `servo-gateway estimate` with its defaults.
Development seeds are 0 to 9999; test seeds from 10000 are for the published table. Clean conditions run `--clean`
cells, the others those of `--seeds`; variants: floor, two loads, 6 poses, wall, ceiling, or all.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks.one_thread import one_thread

VARIANTS = ("floor", "two loads", "6 poses", "wall", "ceiling")


def main(argv: list[str]) -> int:
    """Exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.conflict", description=__doc__)
    parser.add_argument("--seeds", default="0:40", metavar="FIRST:END")
    parser.add_argument("--clean", type=int, default=200, help="cells of a clean condition (at least those of seeds)")
    parser.add_argument("--condition", action="append", help="conditions (all)")
    parser.add_argument("--variant", action="append", choices=(*VARIANTS, "all"), help="floor if omitted")
    parser.add_argument("--command", choices=("estimate", "diagnose"), default="estimate")
    parser.add_argument("--out", type=Path, default=Path("out/conflict"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="print the figures of the cells in OUT; run none")
    arguments = parser.parse_args(argv)
    one_thread()
    from benchmarks.conflict.conditions import CONDITIONS

    unknown = sorted(set(arguments.condition or ()) - set(CONDITIONS))
    if unknown:
        parser.error(f"{', '.join(unknown)}: conditions are {', '.join(CONDITIONS)}")
    first, end = (int(part) for part in arguments.seeds.split(":"))
    chosen = arguments.variant or ["floor"]
    variants = VARIANTS if "all" in chosen else chosen
    tasks = [
        (seed, condition, variant, arguments.command)
        for variant in variants
        for condition in arguments.condition or CONDITIONS
        for seed in range(first, max(end, first + arguments.clean) if CONDITIONS[condition].clean else end)
    ]
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "cells.jsonl"
    if arguments.again:
        answers = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    else:
        from benchmarks.blind.__main__ import run
        from benchmarks.conflict.answers import answer_of

        answers = run(answer_of, tasks, arguments.jobs, path)
    return report(answers, arguments.out)


def report(answers: list[dict], out: Path) -> int:
    """Print the tables, write summary.json; 1 when a goal is missed."""
    from rich.console import Console

    from benchmarks.conflict.figures import check_rates, check_table, condition_table, figures
    from benchmarks.figure import conclude

    console, result = Console(width=170), figures(answers)
    console.print(condition_table(answers))
    print(check_table(answers))
    checks = [{"check": name, "clean": a, "wrong": b, "most": most} for name, a, b, most in check_rates(answers)]
    return conclude(result, out, checks=checks)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
