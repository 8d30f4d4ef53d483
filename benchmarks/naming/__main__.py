"""Draw cells, answer them with the gateway and the baselines, score answers of any method.

- `run [--seeds dev|test] [--count N]`: all of it, with one table.
- `draw OUT --seeds test --count N`: cells in OUT/cells, truth in OUT/truth.
- `score OUT/truth ANSWERS.jsonl ...`: table of any answers.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks.naming.answers import read_answers, write_answers
from benchmarks.naming.cells import FIRST, read_cells, write_cells
from benchmarks.naming.methods import BASELINES, GATEWAY, answer_of
from benchmarks.naming.score import print_columns, read_truth, scores


def main(arguments: list[str]) -> int:
    """Run a subcommand."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run")
    draw = commands.add_parser("draw")
    draw.add_argument("out", type=Path)
    for each in (run, draw):
        each.add_argument("--seeds", choices=list(FIRST), default="dev")
        each.add_argument("--count", type=int, default=120)
    run.add_argument("--out", type=Path, default=Path("out/naming"))
    run.add_argument("--methods", default="", help="comma-separated beginnings of method names; default: all")
    score = commands.add_parser("score")
    score.add_argument("truth", type=Path)
    score.add_argument("answers", type=Path, nargs="+")
    options = parser.parse_args(arguments)
    if options.command == "score":
        print_table(options.truth, options.answers, None)
        return 0
    first = FIRST[options.seeds]
    out: Path = options.out
    write_cells(range(first, first + options.count), out / "cells", out / "truth")
    if options.command == "run":
        wanted = tuple(options.methods.split(","))
        files = [_answered(name, out) for name in (GATEWAY, *BASELINES) if name.startswith(wanted)]
        print_table(out / "truth", files, out / "summary.json")
    return 0


def _answered(method: str, out: Path) -> Path:
    file = out / "answers" / f"{method}.jsonl"
    answers = []
    for number, cell in enumerate(read_cells(out / "cells")):
        answers.append(answer_of(method, cell, number))
        print(f"\r{method}: {number + 1}", end="", file=sys.stderr)
    print(file=sys.stderr)
    write_answers(answers, file)
    return file


def print_table(truth_folder: Path, files: list[Path], summary: Path | None) -> None:
    """Print one column per file of answers, as Markdown; write them to `summary`."""
    truth = read_truth(truth_folder)
    columns = {file.stem: scores(truth, read_answers(file)) for file in files}
    print_columns("figure", columns)
    if summary is not None:
        summary.write_text(json.dumps(columns, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
