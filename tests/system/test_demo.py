"""The demo from the first frame to the report, as `make demo` runs it, on its own cell measured in less time."""

import json
import os
import shutil
import signal
import subprocess
import sys

import pytest

from sim.demo import EXAMPLE
from tests.support.rigs.pacing import HEAVY, measured_shortly

LONGEST_S = 400.0


@pytest.mark.slow
def test_the_demo_names_the_hidden_balancer_and_weighs_the_load(tmp_path):
    shutil.copy(EXAMPLE / "robot.urdf", tmp_path)
    cell = tmp_path / "cell.toml"
    cell.write_text(measured_shortly((EXAMPLE / "cell.toml").read_text(encoding="utf-8"), HEAVY), encoding="utf-8")
    words = [sys.executable, "-m", "sim.demo", "--cell", str(cell), "-o", str(tmp_path / "out")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True) as demo:
        try:
            output, _ = demo.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            os.killpg(demo.pid, signal.SIGKILL)
            raise
    assert demo.returncode == 0, output.decode()
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    truth = result["truth"]
    assert result["verdict"] == "explained"
    found, there = ([(effect["name"], effect["joints"]) for effect in body["effects"]] for body in (result, truth))
    assert found == there
    (load,), (true,) = result["loads"], truth["loads"]
    assert abs(load["mass_kg"] - true["mass_kg"]) < 3 * load["mass_std_kg"]
    assert (tmp_path / "out" / "report.html").exists()
