"""Golden tables: what `estimate` and `diagnose` answer, as differences against the stored answer.

python -m benchmarks.golden [--tables N] [--store] [--against FILE] [--jobs N] [--out out/golden]

Tables of eight conditions are drawn by seeds: rest, one-sided, several loads, stored unloaded arm, 2 to 8 axes, arms
drawn by nature without and with effects, motion. Each condition of `benchmarks.conflict` adds one table. The example
table and the measured runs of SERVO_GATEWAY_DATA are answered too. Loads, standard deviations, verdict, effects,
findings and exit code are stored; processor time is printed beside them. `--tables N` takes the first N. `--store`
replaces the stored answer.
"""

from __future__ import annotations

import argparse
import sys
import time
from multiprocessing import get_context
from pathlib import Path

from benchmarks.one_thread import one_thread

STORED = Path(__file__).with_name("answers.json")


def main(argv: list[str]) -> int:
    """Exit 1 when an answer differs from the stored one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description=__doc__)
    parser.add_argument("--tables", type=int, default=None, help="so many tables (all)")
    parser.add_argument("--store", action="store_true", help="replace the stored answer")
    parser.add_argument("--against", type=Path, default=STORED, help="another stored answer")
    parser.add_argument("--out", type=Path, default=Path("out/golden"), help="folder of this run's answers")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args(argv)
    one_thread()
    from benchmarks.golden.answers import answer_of, read_answers, write_answers
    from benchmarks.golden.differences import changes, print_differences
    from benchmarks.golden.tables import names

    tasks, answers, begin = names()[: arguments.tables], {}, time.monotonic()
    with get_context("spawn").Pool(arguments.jobs) as pool:
        for answer in pool.imap(answer_of, tasks):
            answers[answer["name"]] = answer
            if len(answers) % 10 == 0 or len(answers) == len(tasks):
                print(f"{len(answers)} of {len(tasks)} tables, {time.monotonic() - begin:.0f} s", flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_answers(arguments.out / "answers.json", answers)
    before = read_answers(arguments.against) if arguments.against.exists() else {}
    print_differences(before, answers)
    if arguments.store:
        write_answers(STORED, before | answers)
    return 1 if changes(before, answers) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
