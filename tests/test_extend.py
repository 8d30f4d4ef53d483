"""Every row of the table "to add, touch": what it says is touched, nothing else, and the addition works."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gateway.data.table import write_csv
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions
from gateway.motion.trajectory import MotionLimits, straight
from sim.serve import running
from tests.data.product_copy import ROOT, ProductCopy
from tests.data.resting_arm import Bench
from tests.gateway.pair.together import Together

#: Where the arms are sent [rad].
AWAY_RAD = 0.002
SMALL = ROOT / "examples" / "small" / "cell.toml"
#: Row of the table to the test that proves it.
PROVEN = {
    "a drive model": "test_a_drive_model_is_one_file",
    "an effect": "tests/gateway/model/effects/test_one_file.py",
    "an estimator": "test_an_estimator_is_one_file_and_one_line",
    "a CAN adapter": "test_a_can_adapter_is_named_in_the_cell",
    "another fieldbus": "test_another_fieldbus_is_one_class",
    "an arm, an axis": "tests/system/test_axes_count.py",
}
ESTIMATOR = '''
"""Mass by the mean of two estimators."""

from dataclasses import replace

from gateway.estimate.joint import estimate_joint


def estimate_twice(visits, robot, knowledge):
    found = estimate_joint(visits, robot, knowledge)
    return replace(found, method="twice")
'''
ADAPTER = '''
"""An adapter that is unknown to the gateway."""

from can.interfaces.udp_multicast import UdpMulticastBus


class MadeUpBus(UdpMulticastBus):
    pass
'''


@pytest.fixture
def repository(tmp_path) -> ProductCopy:
    return ProductCopy(tmp_path / "structure")


def test_every_row_of_the_table_is_proven():
    text = (ROOT / "docs" / "explanation" / "code-layout.md").read_text(encoding="utf-8").partition("## Extend")[2]
    rows = [row for row in re.findall(r"^\| ([^|]+) \|", text, flags=re.M) if row not in ("to add", "---")]
    assert rows == list(PROVEN)
    for proof in PROVEN.values():
        assert (ROOT / proof).exists() if proof.endswith(".py") else proof in globals()


@pytest.mark.slow
def test_a_drive_model_is_one_file(repository):
    text = (repository.root / "drives" / "profiles" / "maxon-epos4.toml").read_text()
    repository.add("drives/profiles/newcomer-one.toml", re.sub(r'(?m)^name = ".*"', 'name = "newcomer-one"', text))
    listed = repository.command("profiles", "list")
    assert "newcomer-one" in listed.stdout, listed.stderr
    loop = "tests/drives/test_conformance.py"
    done = repository.run("-m", "pytest", "-v", "-p", "no:cacheprovider", "-n", "0", "-k", "newcomer", loop)
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


@pytest.mark.slow
def test_an_estimator_is_one_file_and_one_line(repository, tmp_path):
    repository.add("gateway/estimate/twice.py", ESTIMATOR)
    repository.change(
        "gateway/estimate/__init__.py",
        '    "posture": _of_visits(estimate_posture),\n',
        '    "posture": _of_visits(estimate_posture),\n    "twice": _of_visits(estimate_twice),\n',
    )
    repository.change(
        "gateway/estimate/__init__.py",
        "from gateway.estimate.posture import estimate_posture\n",
        "from gateway.estimate.posture import estimate_posture\nfrom gateway.estimate.twice import estimate_twice\n",
    )
    bench = Bench(4, [])
    write_csv(bench.both(), tmp_path / "run.csv")
    (tmp_path / "robot.urdf").write_text(bench.arm.urdf)
    line = ("estimate", "run.csv", "--robot", "robot.urdf", "--method", "twice", "--json", "out.json")
    done = repository.command(*line, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    body = json.loads((tmp_path / "out.json").read_text())
    assert body["method"] == "twice"
    assert body["loads"][0]["mass_kg"] > 0


def test_a_can_adapter_is_named_in_the_cell(tmp_path):
    """A package that python-can finds by its entry point; the bus beneath it happens to be UDP."""
    package = tmp_path / "made_up_can-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: made-up-can\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[can.interface]\nmade_up = made_up_can:MadeUpBus\n")
    (tmp_path / "made_up_can.py").write_text(ADAPTER)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        where = f"239.74.163.77,port={free.getsockname()[1]}"
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    line = [sys.executable, "-c", "from gateway.cli import main; main()", "scan", "--bus", f"made_up:{where}"]
    with running(SMALL, f"udp_multicast:{where}", pacing="lockstep"):
        done = subprocess.run(line, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.findall(r"(?m)^\W*([1-9])\W", done.stdout) == list("123456"), done.stdout


def test_another_fieldbus_is_one_class():
    """Drives that no CAN frame ever reaches go through the loop of the gateway, from standing to standing."""
    pair = Together(np.zeros(6))
    try:
        assert not any("can" in type(drives).__module__.split(".") for drives in pair.drives)
        stream = pair.link.stream(pair.cell, MoveOptions())
        with powered(stream):
            answers = []
            for index, workspace in enumerate(stream.workspaces):
                limits = MotionLimits(workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
                at = stream.q_rad[index]
                answers.append(straight(at, at + AWAY_RAD, limits, pair.cell.sync_period_s))
            stream.move(answers, "move")
        for index, arm in enumerate(pair.cell.arms):
            assert pair.part.q_rad[index] == pytest.approx(arm.start_rad + AWAY_RAD, abs=1e-6)
        assert [drives.log for drives in pair.drives] == [["enable", "disable"]] * 2
    finally:
        pair.arms.close()


def test_the_copy_is_the_product(repository):
    """What is proven on the copy is proven on the product: it imports nothing from beside itself."""
    where = repository.run("-c", "import gateway, drives, sim; print(gateway.__file__, drives.__file__, sim.__file__)")
    assert all(Path(path).is_relative_to(repository.root) for path in where.stdout.split())
