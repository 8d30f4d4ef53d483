"""The demo from the first frame to the report, as `make demo` runs it."""

import json
import os
import signal
import subprocess
import sys

import pytest

LONGEST_S = 400.0


@pytest.mark.slow
def test_the_demo_names_the_hidden_balancer_and_weighs_the_load(tmp_path):
    words = [sys.executable, "-m", "sim.demo", "--out", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True) as demo:
        try:
            output, _ = demo.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            os.killpg(demo.pid, signal.SIGKILL)
            raise
    assert demo.returncode == 0, output.decode()
    result = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    truth = result["truth"]
    assert result["verdict"] == "explained"
    assert [effect["name"] for effect in result["effects"]] == [effect["name"] for effect in truth["effects"]]
    (load,), (true,) = result["loads"], truth["loads"]
    assert abs(load["mass_kg"] - true["mass_kg"]) < 3 * load["mass_std_kg"]
    assert (tmp_path / "report.html").exists()
