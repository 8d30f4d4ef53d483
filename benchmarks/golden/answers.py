"""What `estimate` and `diagnose` answer to one table, as it is stored."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from benchmarks.blind.strict import Said, misnamed, right
from benchmarks.conflict.answers import check_of, measured_cell, typed
from benchmarks.golden.tables import CONFLICT, FILES, FIRST_SEED, MAKERS, Case, words_of
from gateway.cli import main
from gateway.diagnose import diagnose
from gateway.errors import GatewayError
from gateway.estimate import run
from gateway.result.result import Result, to_dict

#: No effect of the library: a diagnosis that can name nothing, against `estimate`.
NOTHING = frozenset({"axes_swapped"})


def answer_of(name: str) -> dict:
    """Return what both commands answer to one table of `tables.names`, in numbers that JSON holds."""
    kind, _, number = name.partition("/")
    out: dict = {"name": name, "condition": kind, "truth": {}}
    if kind == CONFLICT:
        cell = measured_cell(FIRST_SEED, number)
        out["truth"] = {"tool": cell.loads["tool"].tolist()}
        for command in ("estimate", "diagnose"):
            with tempfile.TemporaryDirectory() as folder:
                out[command] = _timed(lambda: typed(cell, Path(folder), command)[::2])  # noqa: B023
    elif kind == FILES:
        for command in ("estimate", "diagnose"):
            out[command] = _timed(lambda: _typed_files(words_of(command, number)))  # noqa: B023
    else:
        out |= _seeded(replace(MAKERS[kind](int(number)), condition=kind))
    return json.loads(json.dumps(out))


def _seeded(case: Case) -> dict:
    estimated = _timed(lambda: _of_result(run(case.table, case.robot, case.knowledge)))
    diagnosed = _timed(lambda: _of_result(diagnose(case.table, case.robot, case.knowledge)))
    plain = _timed(lambda: _of_result(diagnose(case.table, case.robot, case.knowledge, only=NOTHING)))
    if case.effects is not None:
        said = Said(tuple((name, tuple(joints)) for name, joints in diagnosed["effects"]), diagnosed["verdict"])
        diagnosed |= {"right": right(case.effects, said), "misnamed": misnamed(case.effects, said)}
    out: dict = {"truth": {label: values.tolist() for label, values in case.loads.items()}}
    out |= {"estimate": estimated, "diagnose": diagnosed}
    if not plain["effects"]:
        out["difference"] = largest_difference(estimated, plain)
    return out


def _of_result(result: Result) -> tuple[int, dict]:
    content = to_dict(result)
    return 7 if any(finding["severity"] == "fail" for finding in content["findings"]) else 0, content


def _typed_files(words: Sequence[str]) -> tuple[int, dict]:
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        code = CliRunner(env={"COLUMNS": "200"}).invoke(main, [*words, "--json", str(answer)]).exit_code
        return code, json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}


def _timed(work: Callable[[], tuple[int, Mapping[str, Any]]]) -> dict:
    """Return exit code, loads, verdict, effects and findings of one command, and its processor time."""
    begin = time.process_time()
    try:
        code, content = work()
    except GatewayError as error:
        code, content = error.exit_code, {}
    return {
        "exit": code,
        "loads": {load["label"]: _load(load) for load in content.get("loads", ())},
        "verdict": str(content.get("verdict", "")),
        "effects": [[effect["name"], list(effect["joints"])] for effect in content.get("effects", ())],
        "findings": sorted({f"{f['severity']} {f['where']}: {check_of(f)}" for f in content.get("findings", ())}),
        "time_s": time.process_time() - begin,
    }


def _load(load: Mapping[str, Any]) -> dict:
    centre, spread = load.get("com_m") or [None] * 3, load.get("com_std_m") or [None] * 3
    values, stds = [load.get("mass_kg"), *centre], [load.get("mass_std_kg"), *spread]
    return {"value": values, "std": stds, "refused": load.get("refused") is not None}


def write_answers(path: Path, answers: Mapping[str, dict]) -> None:
    """Write answers, one table a line."""
    lines = [f"{json.dumps(name)}: {json.dumps(_rounded(answer))}" for name, answer in answers.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def read_answers(path: Path) -> dict[str, dict]:
    """Read answers that `write_answers` wrote."""
    return json.loads(path.read_text(encoding="utf-8"))


def largest_difference(first: Mapping[str, Any], second: Mapping[str, Any]) -> float | None:
    """Return the largest relative difference of loads and standard deviations; None without a load in both."""
    worst: list[float] = []
    for label in first["loads"].keys() & second["loads"].keys():
        for key in ("value", "std"):
            worst += relative(first["loads"][label][key], second["loads"][label][key])
    return max(worst) if worst else None


def relative(first: Sequence[float | None], second: Sequence[float | None]) -> list[float]:
    """Differences of mass and of the centre, each over its own size; 1e9 where only one is known."""
    out = []
    for axes in (slice(0, 1), slice(1, 4)):
        a, b = first[axes], second[axes]
        known = [x is not None for x in a], [x is not None for x in b]
        if known[0] != known[1]:
            out.append(1e9)
            continue
        pairs = np.array([(x, y) for x, y in zip(a, b, strict=True) if x is not None and y is not None], dtype=float)
        if len(pairs):
            size = max(float(np.linalg.norm(pairs[:, 0])), 1e-12)
            out.append(float(np.linalg.norm(pairs[:, 0] - pairs[:, 1])) / size)
    return out


def _rounded(value: object) -> object:
    """The same with eight significant digits."""
    if isinstance(value, float):
        return float(f"{value:.8g}")
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, list) else value
