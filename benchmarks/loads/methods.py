"""Methods of the benchmark, each in a module that is imported only by the process that answers with it."""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.loads.cells import MOTION
from benchmarks.naming.answers import Answer, write_answers
from benchmarks.naming.cells import read_cells
from gateway.errors import GatewayError

#: Module of each method.
METHODS: Final[Mapping[str, str]] = {
    "servo-gateway estimate": "gateway_estimate",
    "weighted least squares": "least_squares",
    "FIGAROH": "figaroh_peer",
    "MuJoCo sysid": "mujoco_peer",
}


def answer_cells(method: str, folder: Path) -> None:
    """Write the answers of a method to all cells of a folder, `rest` or `motion`, and the memory of this process."""
    identify = importlib.import_module(f"benchmarks.loads.{METHODS[method]}").identify
    answers = []
    for number, cell in enumerate(read_cells(folder / "cells")):
        begin, load, std, axes = time.process_time(), None, None, {}
        try:
            found = identify(cell, folder.name == MOTION)
            load, std, axes = found.load, found.load_std, found.axes
        except (GatewayError, np.linalg.LinAlgError, ValueError) as error:
            print(f"\n{method}, {folder.name}, {cell.name}: {error}", file=sys.stderr)
        answers.append(Answer(cell.name, (), False, load, std, time.process_time() - begin, axes))
        print(f"\r{method}, {folder.name}: {number + 1}", end="", file=sys.stderr)
    print(file=sys.stderr)
    write_answers(answers, answers_file(folder, method))
    memory_file(folder, method).write_text(json.dumps(peak_memory_mib()) + "\n", encoding="utf-8")


def answers_file(folder: Path, method: str) -> Path:
    """Return the file of the answers of a method."""
    return folder / "answers" / f"{method}.jsonl"


def memory_file(folder: Path, method: str) -> Path:
    """Return the file with the peak memory of a method [MiB]."""
    return folder / "answers" / f"{method}.memory.json"


def peak_memory_mib() -> float:
    """Return the largest resident size of this process since its start, imports included (Linux)."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1024.0
