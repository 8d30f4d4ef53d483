"""Golden tables: what `estimate` and `diagnose` answer, as differences against the stored answer.

python -m benchmarks.golden [--tables N] [--store] [--against FILE] [--jobs N] [--out out/golden]

Tables of eight conditions are drawn by seeds: rest, one-sided, several loads, stored unloaded arm, 2 to 8 axes, arms
drawn by nature without and with effects, motion. Each condition of `benchmarks.conflict` adds one table. The example
table and the measured runs of SERVO_GATEWAY_DATA are answered too. Loads, standard deviations, verdict, effects,
findings and exit code are stored; processor time is printed beside them. `--tables N` takes the first N. `--store`
replaces the stored answer.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.program import one_thread, options, run

STORED = Path(__file__).with_name("answers.json")


def main() -> int:
    """Exit 1 when an answer differs from the stored one."""
    parser = options(__doc__, "out/golden", jobs=2)
    parser.add_argument("--tables", type=int, default=None, help="so many tables (all)")
    parser.add_argument("--store", action="store_true", help="replace the stored answer")
    parser.add_argument("--against", type=Path, default=STORED, help="another stored answer")
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.golden.answers import answer_of, read_answers, write_answers
    from benchmarks.golden.differences import changes, print_differences
    from benchmarks.golden.tables import names

    tables = run(answer_of, names()[: arguments.tables], arguments.jobs, arguments.out / "tables.jsonl")
    answers = {answer["name"]: answer for answer in tables}
    write_answers(arguments.out / "answers.json", answers)
    before = read_answers(arguments.against) if arguments.against.exists() else {}
    print_differences(before, answers)
    if arguments.store:
        write_answers(STORED, before | answers)
    return 1 if changes(before, answers) else 0


if __name__ == "__main__":
    raise SystemExit(main())
