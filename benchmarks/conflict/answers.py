"""One cell from seed to answer: files, `estimate` as an engineer types it, and what came back against the truth."""

from __future__ import annotations

import json
import re
import tempfile
import time
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from benchmarks.conflict.conditions import CONDITIONS
from benchmarks.conflict.plant import ConflictCell, draw_cell, measure
from gateway.cli import main

#: How far off an answer may be, in stated standard deviations.
FAR = 3.0
DEFECT = 1
#: What is read of a result file.
KEPT = ("findings", "loads", "effects", "noise_floor_nm", "verdict")


def answer_of(task: tuple[int, str, str, str]) -> dict:
    """Draw and measure one cell and type the command: seed, condition, variant, `estimate` or `diagnose`."""
    seed, condition, variant, command = task
    cell = measured_cell(seed, condition, variant)
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        code, output, result = typed(cell, Path(folder), command)
    record = {"seed": seed, "condition": condition, "variant": variant, "exit": code, "rated_kg": cell.arm.rated_kg}
    record["time_s"] = time.process_time() - begin
    record["findings"] = [
        [finding["severity"], check_of(finding), finding["where"], finding["what"]] for finding in result["findings"]
    ]
    record["message"] = output.strip()[-400:] if code not in (0, 7) else ""
    record["effects"] = [f"{effect['name']} {effect['joints']}" for effect in result["effects"]]
    record["outliers"] = cell.outliers
    record["loads"] = [_judged(load, _truths(cell, load["label"])) for load in result["loads"]]
    return json.loads(json.dumps(record))


def measured_cell(seed: int, condition: str, variant: str = "floor") -> ConflictCell:
    """Return a cell after its measurement and the changes of its condition."""
    cell = draw_cell(seed, variant)
    CONDITIONS[condition].before(cell)
    cell.columns = measure(cell)
    CONDITIONS[condition].after(cell)
    return cell


def write_cell(cell: ConflictCell, folder: Path) -> tuple[Path, Path]:
    """Write the table and the URDF of a cell."""
    robot, table = folder / "arm.urdf", folder / "table.csv"
    robot.write_text(cell.arm.geometry.urdf(cell.stated, cell.length_unit), encoding="utf-8")
    _write(table, cell.columns, np.full(len(cell.columns["pose"]), True))
    return table, robot


def _write(path: Path, columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
    values = [[str(value) for value in column[rows].tolist()] for column in columns.values()]
    lines = [",".join(columns), *(",".join(row) for row in zip(*values, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def typed(cell: ConflictCell, folder: Path, command: str = "estimate") -> tuple[int, str, dict]:
    """Exit code, output and result (findings, loads, effects) of a command with the cell's files and options."""
    table, robot = write_cell(cell, folder)
    options, before = [*cell.options], []
    if cell.stored_bare:
        bare = cell.columns["load"] == "none"
        table = folder / "loaded.csv"
        _write(folder / "bare.csv", cell.columns, bare)
        _write(table, cell.columns, ~bare)
        _, _, first = _run("estimate", folder / "bare.csv", robot, [], folder / "bare.json")
        options += ["--bare", str(folder / "bare.json")]
        before = first["findings"]
    code, output, found = _run(command, table, robot, options, folder / "answer.json")
    return code, output, found | {"findings": [*before, *found["findings"]]}


def _run(command: str, table: Path, robot: Path, options: list[str], answer: Path) -> tuple[int, str, dict]:
    words = [command, str(table), "--robot", str(robot), *options, "--json", str(answer)]
    result = CliRunner(env={"COLUMNS": "200"}).invoke(main, words)
    found = json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}
    return (
        result.exit_code,
        result.output,
        {key: found.get(key, []) for key in KEPT},
    )


def check_of(finding: dict) -> str:
    """Name of the check that reports a finding: its own, else the beginning of its text, up to the first number."""
    if finding.get("check"):
        return str(finding["check"])
    minus, either = "\N{MINUS SIGN}", "\N{PLUS-MINUS SIGN}"
    text = re.sub(rf"^[-{minus}]?[\d.]+ ", "", str(finding["what"]).removeprefix("refused: "))
    begin = re.split(rf" [-+]|[\d{minus}{either}:(]", text)[0]
    return begin.strip()[:70] or str(finding["where"])


def _truths(cell: ConflictCell, label: str) -> list[list[float]]:
    """Every load that was measured under this label."""
    keys = [key for block in cell.blocks if block.label == label for key in (block.load, block.later) if key]
    return [list(map(float, cell.loads[key])) for key in keys]


def _judged(load: dict, truths: list[list[float]]) -> dict:
    """Mass error and stated standard deviation over the true mass, of the worst truth."""
    mass, std = load.get("mass_kg"), load.get("mass_std_kg")
    record: dict = {"label": load["label"], "refused": load.get("refused"), "mass_kg": truths[0][0]}
    if mass is None or std is None:
        return record | {"off": None}
    worst = max(truths, key=lambda truth: abs(mass - truth[0]))
    off = abs(mass - worst[0]) / max(std, 1e-12)
    return record | {"error": mass / worst[0] - 1.0, "std": std / worst[0], "off": off}
