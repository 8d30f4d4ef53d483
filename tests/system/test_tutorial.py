"""Ten minutes, tutorials, first day on hardware, typed line by line: commands work, results are in their interval.

The port of the bus is a free one, because tests run in parallel. The arm of the example is measured in less time.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

import pytest

from gateway.cell.config import load_cell
from gateway.jobs.rehearse import rehearse
from sim.cellfile import read_payloads
from sim.serve import free_bus, wait_until_ready
from tests.support.rigs.pacing import SHORTLY, in_lockstep, measured_shortly
from tests.system.conftest import command

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
#: Of the motor on a bench, which is moved by longer setpoints than an arm.
AS_TYPED = {"sync_period_s": 0.02, "approach_speed_rad_s": 0.15, "samples": 30, "count": 6, "validation": 2}
_BLOCK = re.compile(r"^ *```([^\n]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
_REMARK = re.compile(r" +# .*| *\\\n *")


@dataclass(frozen=True)
class Block:
    """Text between fences: kind "" is typed in a terminal, `sim` in that of the simulator, `toml` is a file.

    Of kind `sh` are lines for another environment than that of a test.
    """

    kind: str
    lines: tuple[str, ...]


def blocks(text: str) -> list[Block]:
    """Return all blocks of a page; typed lines are whole and without remarks."""
    found = ((kind, body if kind else _REMARK.sub(" ", dedent(body))) for kind, body in _BLOCK.findall(text))
    return [Block(kind, tuple(line.rstrip() for line in body.strip().splitlines())) for kind, body in found]


@contextmanager
def simulator(words: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Run `servo-sim` in a separate process."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-m", "sim", *words[1:]], **pipes, text=True)
    try:
        wait_until_ready(process)
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=20)


def typed_page(
    page: str, port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, examples: tuple[str, ...]
) -> list[str]:
    """Type each line of a page in `tmp_path`, on a free port; return the first words of the commands."""
    free = free_bus().rpartition("=")[2]
    for name in examples:
        shutil.copytree(ROOT / "examples" / name, tmp_path / "examples" / name)
    for cell in (tmp_path / "examples").rglob("cell.toml"):
        text = in_lockstep(cell.read_text(encoding="utf-8")).replace(port, free)
        cell.write_text(measured_shortly(text, AS_TYPED if "bench" in examples else SHORTLY), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(tmp_path)
    typed = []
    with ExitStack() as stack:
        drives = None
        for block in blocks((DOCS / page).read_text(encoding="utf-8").replace(port, free)):
            if block.kind == "toml":
                Path(block.lines[0].removeprefix("# ")).write_text("\n".join(block.lines), encoding="utf-8")
                continue
            for line in block.lines if block.kind in ("", "sim") else ():
                words = shlex.split(line)
                if block.kind == "sim":
                    print(line, file=drives.stdin, flush=True)
                    assert "on the flange" in drives.stdout.readline()
                elif words[0] in ("mkdir", "cp"):
                    subprocess.run(words, check=True)
                elif words[0] == "servo-sim":
                    drives = stack.enter_context(simulator(words))
                else:
                    assert words[0] == "servo-gateway", line
                    done = command(*words[1:], input="y\n" * 3)
                    assert done.exit_code == 0, (line, done.output)
                    typed.append(words[1])
    return typed


@pytest.mark.slow
def test_ten_minutes_of_the_readme_as_typed(tmp_path, monkeypatch):
    typed = typed_page("../README.md", "43114", tmp_path, monkeypatch, ("small",))
    assert typed[-3:] == ["report", "export", "follow"]
    (load,) = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["loads"]
    (true,) = read_payloads(tmp_path / "examples" / "small" / "payload.toml").values()
    assert abs(load["mass_kg"] - true.mass_kg) < 1.96 * load["mass_std_kg"]


@pytest.mark.slow
def test_your_own_robot_as_typed(tmp_path, monkeypatch):
    (tmp_path / "out" / "own").mkdir(parents=True)
    typed_page("tutorial/your-own-robot.md", "43117", tmp_path, monkeypatch, ("own",))
    (arm,) = load_cell(tmp_path / "out" / "own" / "cell.toml").cell.arm
    assert [axis.node_id for axis in arm.axis] == [11, 12, 13, 14, 15, 16]
    assert arm.axis[0].torque_limit_nm == 140
    assert 2.78 < arm.axis[0].position_limit_rad[1] < 2.85, "the URDF permits 2.9, the drive stops at 2.85"
    (load,) = json.loads((tmp_path / "out" / "own" / "result.json").read_text(encoding="utf-8"))["loads"]
    (true,) = read_payloads(tmp_path / "examples" / "own" / "bench" / "payload.toml").values()
    assert f"weighs {true.mass_kg:g} kg" in (DOCS / "tutorial" / "your-own-robot.md").read_text(encoding="utf-8")
    assert abs(load["mass_kg"] - true.mass_kg) < 1.96 * load["mass_std_kg"]


@pytest.mark.slow
def test_arrival_to_signature_as_typed(tmp_path, monkeypatch):
    typed = typed_page("tutorial/arrival-to-signature.md", "43114", tmp_path, monkeypatch, ("small",))
    assert typed[-5:] == ["accept", "report", "export", "replay", "restore"]
    out = tmp_path / "out" / "arrival"
    (load,) = json.loads((out / "result.json").read_text(encoding="utf-8"))["loads"]
    true = read_payloads(out / "payload.toml")["gripper"]
    assert abs(load["mass_kg"] - true.mass_kg) < 1.96 * load["mass_std_kg"]
    certificate = (out / "certificate.xml").read_text(encoding="utf-8")
    assert "NOT TRACEABLE" not in certificate
    assert (out / "cell.calibration.toml").is_file()
    assert len(list((out / "drives").glob("J*.json"))) == 6


@pytest.mark.slow
def test_before_the_robot_as_typed(tmp_path, monkeypatch):
    typed = typed_page("tutorial/before-the-robot.md", "43114", tmp_path, monkeypatch, ("small",))
    assert typed == ["plan", "rehearse", "report", "plan"]
    out = tmp_path / "out" / "before"
    body = json.loads((out / "rehearsal.json").read_text(encoding="utf-8"))
    (tilt,) = body["effects"]
    assert tilt["name"] == "base_tilt"
    assert tilt["recovered"]
    assert 1.0 < tilt["detection_strength"] < 40.0
    assert len(body["runs"]) == 2 + 9
    assert (out / "rehearsal.html").read_text(encoding="utf-8").count("<circle") == 9
    assert body["load"]["as_stated"]["inside"] >= 6
    assert body["load"]["calibrated"]["mass_std_share"] < body["load"]["as_stated"]["mass_std_share"]
    told: list[tuple[int, int]] = []
    earlier = body | {"runs": [run for run in body["runs"] if run["seed"] != 1]}
    asked = {"plan_file": out / "plan.json", "effects": {"base_tilt"}, "clean_arms": 2, "earlier": earlier}
    again = rehearse(out / "cell.toml", **asked, done=lambda _body, places, total: told.append((places, total)))
    assert told == [(3, 3)]
    assert sorted(again["runs"], key=lambda run: run["seed"]) == sorted(body["runs"], key=lambda run: run["seed"])
    plans = [json.loads((out / name).read_text(encoding="utf-8")) for name in ("plan.json", "plan-2.json")]
    assert len(plans[0]["poses"]) == len(plans[1]["poses"])
    assert body["time_under_power_s"] == pytest.approx(2.0 * plans[0]["duration_s"])


@pytest.mark.slow
def test_first_real_drive_as_typed(tmp_path, monkeypatch):
    typed = typed_page("how-to/first-real-drive.md", "43118", tmp_path, monkeypatch, ("bench", "own"))
    assert typed[:7] == ["doctor", "scan", "profiles", "cell", "check", "check", "move"]
    assert typed[-2:] == ["estimate", "replay"]
    out, bench = tmp_path / "out" / "bench", tmp_path / "examples" / "bench" / "cell.toml"
    (stored,) = tomllib.loads((out / "cell.calibration.toml").read_text(encoding="utf-8"))["arm"][0]["axis"]
    true = tomllib.loads(bench.read_text(encoding="utf-8"))["arm"][0]["axis"][0]["torque_constant_nm_per_a"]["value"]
    assert f"{true:g} Nm/A" in (DOCS / "how-to" / "first-real-drive.md").read_text(encoding="utf-8")
    assert stored["std_percent"] < 1
    assert abs(stored["torque_constant_nm_per_a"] / true - 1) < 0.0196 * stored["std_percent"]
    serial = stored["serial_number"]
    with zipfile.ZipFile(out / "first-day.zip") as sent:
        for content in map(sent.read, sent.namelist()):
            assert not any(each in content for each in (str(serial).encode(), f"{serial:X}".encode(), bytes(tmp_path)))
