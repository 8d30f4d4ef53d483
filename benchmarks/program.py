"""Frame of the programs of this folder: options, linear algebra in one thread, cells in several processes."""

from __future__ import annotations

import argparse
import json
import os
import re
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any


def options(doc: str | None, out: str | None, *, jobs: int = 0, parts: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Parser of a program, named as in the usage line of its docstring, to which further options are added.

    Parameters
    ----------
    doc : str
        Docstring of the module, with ``python -m PROGRAM`` in it.
    out : str, optional
        Default of `--out`, the folder of the results; None where it depends on other options.
    jobs : int
        Default of `--jobs`, number of processes; 0 = without this option.
    parts : sequence of str
        Names of which any may be given; none = without them. `parts` of the result is all of them by default.
    """
    usage = re.search(r"python -m [\w.]+", doc or "")
    parser = argparse.ArgumentParser(prog=usage and usage[0], description=doc)
    parser.add_argument("--out", type=Path, default=out)
    if jobs:
        parser.add_argument("--jobs", type=int, default=jobs, help="number of processes")
    if parts:
        words = f"of {', '.join(parts)}; all by default"
        parser.add_argument("parts", nargs="*", choices=[*parts, parts], default=parts, metavar="PART", help=words)
    return parser


def seed_range(text: str) -> range:
    """Seeds of an option FIRST:END; END is not among them."""
    first, end = map(int, text.split(":"))
    return range(first, end)


def numbers(text: str) -> list[int]:
    """Integers of an option, separated by commas."""
    return [int(word) for word in text.split(",")]


def one_thread() -> None:
    """Limit linear algebra to one thread in this process and its children; to be called before numpy is imported.

    For small matrices two threads take ten times as long, and processes share the cores.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


def run(work: Callable[[Any], dict], tasks: Sequence[Any], jobs: int, path: Path) -> list[dict]:
    """Results of all tasks in their order, from `jobs` processes; each is written to a file of JSON lines at once."""
    results, begin = [], time.monotonic()
    path.parent.mkdir(parents=True, exist_ok=True)
    with get_context("spawn").Pool(jobs) as pool, path.open("w", encoding="utf-8") as stream:
        for count, result in enumerate(pool.imap(work, tasks), start=1):
            line = json.dumps(result)
            results.append(json.loads(line))
            stream.write(line + "\n")
            stream.flush()
            if count % 25 == 0 or count == len(tasks):
                print(f"{path.stem}: {count} of {len(tasks)}, {time.monotonic() - begin:.0f} s", flush=True)
    return results


def figures_of(package: str, parts: Sequence[str]) -> dict[str, dict]:
    """Figures of modules of `benchmarks`, each from its `figures()`."""
    figures: dict[str, dict] = {}
    for part in parts:
        figures |= import_module(f"benchmarks.{package}.{part}").figures()
    return figures
