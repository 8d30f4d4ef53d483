"""The next load after `calibrate` with one weighed load: mass error, and whether the 95 % intervals hold.

python -m benchmarks.calibration [--seeds 10000:10200] [--centre known|unknown|both] [--out out/calibration]

Random arms of `benchmarks.conflict` (torque by pinocchio, friction and gears of their own), torque constants with a
standard deviation of 3 %. A load of half the rated one is measured between two unloaded blocks and handed to
`servo-gateway calibrate`. The next load, 30 to 100 % of the rated one, is measured with other friction and noise and
handed to `servo-gateway estimate`, with and without the calibration file. Development seeds are 0 to 9999.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.support.one_thread import one_thread

#: Half width of a 95 % interval in standard deviations.
HALF_WIDTH = 1.96
CELL = """name = "drawn"
[bus.a]
interface = "virtual"
channel = "calibration"
[[arm]]
name = "main"
bus = "a"
robot = "arm.urdf"
inertials = "prior:0.05"
rated_load_kg = {{ value = {rated:.6g}, source = "drawn" }}
{axes}"""
AXIS = """[[arm.axis]]
node_id = {number}
profile = "generic-cia402"
torque_constant_nm_per_a = {{ value = 1.0, source = "datasheet", std_percent = 3.0 }}
gear_ratio = {{ value = 100, source = "drawn" }}
gear_efficiency = {{ value = 1.0, source = "assumed" }}
position_sign = 1
torque_sign = 1
zero_offset_rad = 0.0
position_limit_rad = [{low:.6g}, {high:.6g}]
speed_limit_rad_s = 0.5
torque_limit_nm = {torque:.6g}
"""


def main(argv: list[str]) -> int:
    """Exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--seeds", default="10000:10200", metavar="FIRST:END")
    parser.add_argument("--centre", choices=("known", "unknown", "both"), default="both", help="of the weighed load")
    parser.add_argument("--out", type=Path, default=Path("out/calibration"))
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args(argv)
    one_thread()
    from benchmarks.blind.__main__ import run
    from tests.support.figure import show

    first, end = (int(part) for part in arguments.seeds.split(":"))
    centres = ("known", "unknown") if arguments.centre == "both" else (arguments.centre,)
    tasks = [(seed, centre) for centre in centres for seed in range(first, end)]
    arguments.out.mkdir(parents=True, exist_ok=True)
    answers = run(next_load, tasks, arguments.jobs, arguments.out / "cells.jsonl")
    result = {name: entry for centre in centres for name, entry in figures(answers, centre).items()}
    (arguments.out / "summary.json").write_text(json.dumps({"figures": result}, indent=1) + "\n", encoding="utf-8")
    show(result)
    return 0 if all(entry["met"] is not False for entry in result.values()) else 1


def next_load(task: tuple[int, str]) -> dict:
    """Calibrate one arm and estimate its next load: error and standard deviation over the mass, before and after."""
    from benchmarks.conflict.answers import write_cell
    from benchmarks.conflict.plant import LoadBlock, draw_cell, measure
    from gateway.identify.drift import AGAIN

    seed, centre = task
    drawn = draw_cell(seed)
    rng = np.random.default_rng([seed, 4])
    drawn.gain = 0.03 * rng.standard_normal(len(drawn.gain))
    offset = 0.45 * drawn.arm.rated_kg**0.34 * np.array([0.08, 0.08, 0.10])
    weight = np.array([0.5 * drawn.arm.rated_kg, *(offset * rng.normal(size=3))])
    drawn.loads["weight"] = weight
    bare, loaded = drawn.blocks
    length_s = loaded.start_s - bare.start_s
    again = LoadBlock("none", "again", 2.0 * length_s, load="none")
    figures_: dict = {"seed": seed, "centre": centre}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_cell_file(drawn, folder)
        drawn.blocks = [bare, replace(loaded, label="weight", load="weight"), again]
        drawn.columns = measure(drawn)
        drawn.columns["pose"] = drawn.columns["pose"] + np.where(drawn.columns["run"] == again.run, AGAIN, 0)
        table = write_cell(drawn, folder)[0].rename(folder / "weighed.csv")
        drawn.blocks = [bare, loaded]
        drawn.columns = measure(drawn)
        write_cell(drawn, folder)
        figures_["before"] = judged(folder, drawn.loads["tool"][0])
        known = ",".join(f"{value:.9g}" for value in (weight if centre == "known" else weight[:1]))
        figures_["calibrated"], figures_["axes"] = calibrated(folder, table, known, drawn.gain)
        figures_["after"] = judged(folder, drawn.loads["tool"][0])
    return json.loads(json.dumps(figures_))


def write_cell_file(drawn, folder: Path) -> None:
    """The cell file of a drawn arm."""
    axes = [
        AXIS.format(number=number, low=-limit, high=limit, torque=10.0 * size)
        for number, (limit, size) in enumerate(zip(drawn.arm.geometry.limit_rad, drawn.size_nm, strict=True), 1)
    ]
    (folder / "cell.toml").write_text(CELL.format(rated=drawn.arm.rated_kg, axes="".join(axes)), encoding="utf-8")


def invoked(*words: object) -> tuple[int, str]:
    """Exit code and output of a command."""
    from click.testing import CliRunner

    from gateway.cli import main as command

    done = CliRunner(env={"COLUMNS": "200"}).invoke(command, [str(word) for word in words])
    return done.exit_code, done.stderr


def calibrated(folder: Path, table: Path, known: str, gain: np.ndarray) -> tuple[int, list[list[float]]]:
    """Exit code of `calibrate`; per stored axis its number, error and standard deviation of the scale, relative."""
    answer = folder / "calibration.json"
    words = ("calibrate", folder / "cell.toml", "--known", f"weight={known}", "--from", table, "--json", answer)
    code, output = invoked(*words)
    if not answer.exists():
        print(f"calibrate: exit {code}: {output[-300:]}", file=sys.stderr)
        return code, []
    axes = [axis for axis in json.loads(answer.read_text(encoding="utf-8"))["axes"] if axis["is_known"]]
    return code, [[axis["joint"], axis["scale"] * (1 + gain[axis["joint"] - 1]) - 1, axis["std"]] for axis in axes]


def judged(folder: Path, mass_kg: float) -> dict:
    """Relative error and standard deviation of the mass by `estimate`."""
    answer = folder / "answer.json"
    answer.unlink(missing_ok=True)
    code, output = invoked("estimate", folder / "table.csv", "--warm", "--cell", folder / "cell.toml", "--json", answer)
    load = json.loads(answer.read_text(encoding="utf-8"))["loads"][0] if answer.exists() else {}
    if load.get("mass_kg") is None:
        print(f"estimate: exit {code}: {output[-300:]}", file=sys.stderr)
        return {"error": None, "std": None}
    return {"error": load["mass_kg"] / mass_kg - 1.0, "std": load["mass_std_kg"] / mass_kg}


def figures(answers: list[dict], centre: str) -> dict[str, dict]:
    """Figures of one type of weighed load."""
    from tests.support.figure import figure

    own = [answer for answer in answers if answer["centre"] == centre]
    stored = [answer for answer in own if answer["calibrated"] == 0]
    out = {f"centre {centre}: calibrations stored [share]": figure(len(stored) / len(own), ">= 0.98")}
    for when in ("before", "after"):
        figures_ = [answer[when] for answer in stored if answer[when]["error"] is not None]
        error, std = np.array([[each["error"], each["std"]] for each in figures_]).T
        holds = float(np.mean(np.abs(error) < HALF_WIDTH * std))
        half = HALF_WIDTH * np.sqrt(max(holds * (1 - holds), 1e-9) / len(figures_))
        name = f"centre {centre}, {when}"
        median = figure(100 * float(np.median(np.abs(error))), "<= 0.4", "%")
        rows = {
            f"{name}: median error of the mass": median,
            f"{name}: median standard deviation": figure(100 * float(np.median(std)), "<= 100", "%"),
            f"{name}: 95 % intervals hold": figure(
                100 * holds, ">= 93", "%", (100 * (holds - half), 100 * (holds + half))
            ),
        }
        if when == "before":
            for entry in rows.values():
                entry |= {"goal": "printed", "met": None}
        else:
            rows[f"{name}: median standard deviation"] |= {"goal": "printed", "met": None}
            rows[f"{name}: 95 % intervals hold"] |= {"goal": "93 to 97", "met": 93.0 <= 100 * holds <= 97.0}
        out |= rows
    return out


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
