"""Freeze what `estimate` and `diagnose` answer, and compare a later version with it.

python -m benchmarks.compare [--tables N] [--store FILE] [--against FILE] [--jobs N]

300 seeded tables of eight conditions; `--tables N` takes the first N, conditions alternating. `--store` writes loads,
standard deviations, verdicts, named effects and processor time as JSON; `--against` prints the differences per
condition.
"""

from __future__ import annotations

import argparse
import sys
import time
from multiprocessing import get_context
from pathlib import Path

from tests.support.one_thread import one_thread

TABLES = 300


def main(argv: list[str]) -> int:
    """Exit 0; the tables are for an engineer to judge."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare", description=__doc__)
    parser.add_argument("--tables", type=int, default=TABLES, help=f"so many of the {TABLES} tables")
    parser.add_argument("--store", type=Path, default=None, help="write the answers here")
    parser.add_argument("--against", type=Path, default=None, help="answers of an earlier version")
    parser.add_argument("--answers", type=Path, default=None, help="compare this stored file instead of a new run")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args(argv)
    one_thread()
    from benchmarks.compare.answers import read_answers, write_answers
    from benchmarks.compare.differences import print_differences

    if arguments.answers is not None:
        answers = read_answers(arguments.answers)
    else:
        answers = _run(min(arguments.tables, TABLES), arguments.jobs)
    if arguments.store is not None:
        write_answers(arguments.store, answers)
    print_differences(read_answers(arguments.against) if arguments.against else {}, answers)
    return 0


def _run(count: int, jobs: int) -> dict[str, dict]:
    from benchmarks.compare.answers import answer_of

    answers, begin = {}, time.monotonic()
    with get_context("spawn").Pool(jobs) as pool:
        for answer in pool.imap(answer_of, range(count)):
            answers[str(answer["number"])] = answer
            if len(answers) % 10 == 0 or len(answers) == count:
                print(f"{len(answers)} of {count} tables, {time.monotonic() - begin:.0f} s", flush=True)
    return answers


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
