"""How often wrong statements about an arm pass silently, and right ones raise an alarm.

python -m benchmarks.conflict [--seeds 0:40] [--clean N] [--condition NAME]... [--variant NAME]... [--command diagnose]

Random arms of 3 to 200 kg rated load, measured bare and loaded, handed to `servo-gateway estimate` with its defaults.
Development seeds are 0 to 9999; test seeds from 10000 are for the published table. Clean conditions run `--clean`
cells, the others those of `--seeds`; variants: floor, two loads, 6 poses, wall, ceiling, or all.
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.program import one_thread, options, run, seed_range

VARIANTS = ("floor", "two loads", "6 poses", "wall", "ceiling")


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/conflict", jobs=1)
    parser.add_argument("--seeds", type=seed_range, default="0:40", metavar="FIRST:END")
    parser.add_argument("--clean", type=int, default=200, help="cells of a clean condition (at least those of seeds)")
    parser.add_argument("--condition", action="append", help="conditions (all)")
    parser.add_argument("--variant", action="append", choices=(*VARIANTS, "all"), help="floor if omitted")
    parser.add_argument("--command", choices=("estimate", "diagnose"), default="estimate")
    parser.add_argument("--again", action="store_true", help="print the figures of the cells in OUT; run none")
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.conflict.conditions import CONDITIONS

    unknown = sorted(set(arguments.condition or ()) - set(CONDITIONS))
    if unknown:
        parser.error(f"{', '.join(unknown)}: conditions are {', '.join(CONDITIONS)}")
    first, end = arguments.seeds.start, arguments.seeds.stop
    chosen = arguments.variant or ["floor"]
    variants = VARIANTS if "all" in chosen else chosen
    tasks = [
        (seed, condition, variant, arguments.command)
        for variant in variants
        for condition in arguments.condition or CONDITIONS
        for seed in range(first, max(end, first + arguments.clean) if CONDITIONS[condition].clean else end)
    ]
    path = arguments.out / "cells.jsonl"
    if arguments.again:
        answers = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    else:
        from benchmarks.conflict.answers import answer_of

        answers = run(answer_of, tasks, arguments.jobs, path)
    return report(answers, arguments.out)


def report(answers: list[dict], out: Path) -> int:
    """Print the tables, write summary.json; 1 when a goal is missed."""
    from benchmarks.conflict.figures import check_rates, check_table, condition_rows, figures
    from benchmarks.figure import conclude, print_table

    heads = ("condition", "variant", "cells", "unreported", "warned", "refused", "mean error", "rms", "median std", "s")
    print_table(heads, condition_rows(answers), "unreported: off by 3 stated std, no warning, no refusal")
    print(check_table(answers))
    checks = [{"check": name, "clean": a, "wrong": b, "most": most} for name, a, b, most in check_rates(answers)]
    return conclude(figures(answers), out, checks=checks)


if __name__ == "__main__":
    raise SystemExit(main())
