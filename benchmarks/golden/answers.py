"""What `estimate` and `diagnose` answer to one table, as it is stored."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.compare.tables import Case, case
from gateway.diagnose import diagnose
from gateway.errors import GatewayError
from gateway.estimate import run
from gateway.result.result import LoadResult, Result
from tests.support.blind.strict import Said, misnamed, right

#: No effect of the library: a diagnosis that can name nothing, against `estimate`.
NOTHING = frozenset({"axes_swapped"})


def answer_of(number: int) -> dict:
    """Return what both commands answer to table `number`, in numbers that JSON holds."""
    one = case(number)
    out = {"number": number, "condition": one.condition, "seed": one.seed, "rows": len(one.table.load)}
    out["truth"] = {label: values.tolist() for label, values in one.loads.items()}
    estimated = _timed(lambda: run(one.table, one.robot, one.estimate), _loads)
    out["estimate"] = estimated
    out["diagnose"] = _timed(lambda: diagnose(one.table, one.robot, one.diagnose), lambda r: _diagnosed(one, r))
    nothing = replace(one.diagnose, only=NOTHING)
    plain = _timed(lambda: diagnose(one.table, one.robot, nothing), _diagnosed_plain)
    if not plain.get("effects"):
        out["difference"] = _difference(estimated, plain)
    return json.loads(json.dumps(out))


def write_answers(path: Path, answers: dict[str, dict]) -> None:
    """Write answers, one table a line."""
    lines = [f"{json.dumps(number)}: {json.dumps(_rounded(answer))}" for number, answer in answers.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def read_answers(path: Path) -> dict[str, dict]:
    """Read answers that `write_answers` wrote."""
    return json.loads(path.read_text(encoding="utf-8"))


def _timed(work: Callable[[], Result], kept: Callable[[Result], dict]) -> dict:
    begin = time.process_time()
    try:
        result = work()
    except GatewayError as error:
        return {"refused": str(error), "time_s": time.process_time() - begin}
    return {**kept(result), "time_s": time.process_time() - begin}


def _loads(result: Result) -> dict:
    return {"loads": {load.label: _load(load) for load in result.loads}}


def _load(load: LoadResult) -> dict:
    centre = [None] * 3 if load.com_m is None else load.com_m
    spread = [None] * 3 if load.com_std_m is None else load.com_std_m
    values = [None if v is None or not math.isfinite(v) else float(v) for v in (load.mass_kg, *centre)]
    stds = [None if v is None or not math.isfinite(v) else float(v) for v in (load.mass_std_kg, *spread)]
    return {"value": values, "std": stds, "refused": load.refused}


def _diagnosed_plain(result: Result) -> dict:
    return {
        **_loads(result),
        "verdict": str(result.verdict),
        "effects": [[effect.name, list(effect.joints)] for effect in result.effects],
    }


def _diagnosed(one: Case, result: Result) -> dict:
    out = _diagnosed_plain(result)
    if one.effects is not None:
        said = Said(tuple((name, tuple(joints)) for name, joints in out["effects"]), out["verdict"])
        out |= {"right": right(one.effects, said), "misnamed": misnamed(one.effects, said)}
    return out


def _difference(first: dict, second: dict) -> float | None:
    """Largest relative difference of loads and standard deviations; None where not both have an answer."""
    worst: list[float] = []
    for label, load in first.get("loads", {}).items():
        other = second.get("loads", {}).get(label)
        if other is None:
            return None
        for key in ("value", "std"):
            worst += relative(load[key], other[key])
    return max(worst) if worst and "loads" in second else None


def relative(first: Sequence[float | None], second: Sequence[float | None]) -> list[float]:
    """Differences of mass and of the centre, each over its own size; infinite where one alone is known."""
    out = []
    for part in (slice(0, 1), slice(1, 4)):
        a, b = first[part], second[part]
        known = [x is not None for x in a], [x is not None for x in b]
        if known[0] != known[1]:
            out.append(math.inf)
            continue
        pairs = np.array([(x, y) for x, y in zip(a, b, strict=True) if x is not None and y is not None], dtype=float)
        if len(pairs):
            size = max(float(np.linalg.norm(pairs[:, 0])), 1e-12)
            out.append(float(np.linalg.norm(pairs[:, 0] - pairs[:, 1])) / size)
    return out


def _rounded(value: object) -> object:
    """The same with twelve significant digits."""
    if isinstance(value, float):
        return float(f"{value:.12g}")
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, list) else value
