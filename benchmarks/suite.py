"""Processor time of the test suite by test, shared fixture and package, children included.

python -m benchmarks.suite [--out out/suite] [--most 25] [-- PYTEST ARGUMENTS]

Runs pytest with two processes (`-m "not slow"` unless other arguments are given) and prints the slowest first.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.table import Table

FAST = ("-n", "2", "--dist", "loadgroup", "-m", "not slow")


def main(argv: list[str]) -> int:
    """Exit with the code of pytest."""
    argv, _, passed = (argv[: argv.index("--")], "--", argv[argv.index("--") + 1 :]) if "--" in argv else (argv, "", [])
    parser = argparse.ArgumentParser(prog="python -m benchmarks.suite", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/suite"))
    parser.add_argument("--most", type=int, default=25, help="rows of each table")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for old in arguments.out.glob("times-*.jsonl"):
        old.unlink()
    begin_s, before = time.monotonic(), os.times()
    line = [sys.executable, "-m", "pytest", "-p", "tests.support.time_log", *(passed or FAST)]
    code = subprocess.run(line, env=os.environ | {"TEST_TIMES": str(arguments.out.resolve())}, check=False).returncode
    wall_s, after = time.monotonic() - begin_s, os.times()
    total_s = sum(after[2:4]) - sum(before[2:4])
    rows = [json.loads(text) for file in arguments.out.glob("times-*.jsonl") for text in file.read_text().splitlines()]
    tests = Counter({row["test"]: row["spent_s"] for row in rows if "test" in row})
    fixtures: Counter[str] = Counter()
    packages: Counter[str] = Counter()
    for row in rows:
        if "fixture" in row:
            fixtures[row["fixture"]] += row["spent_s"]
        packages["/".join(row.get("test", row.get("file", "")).split("::")[0].split("/")[:3])] += row["spent_s"]
    for title, of in (("test", tests), ("shared fixture", fixtures), ("package", packages)):
        _print(title, of, arguments.most)
    totals = {"tests": len(tests), "processor_time_s": round(total_s, 1), "wall_time_s": round(wall_s, 1)}
    print(", ".join(f"{name} {value}" for name, value in totals.items()))
    summary = totals | {"slowest": tests.most_common(arguments.most), "packages": packages.most_common()}
    (arguments.out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return code


def _print(title: str, of: Counter[str], most: int) -> None:
    table = Table(title, "processor time [s]")
    for name, spent_s in of.most_common(most):
        table.add_row(name, f"{spent_s:.2f}")
    Console(width=150).print(table)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
