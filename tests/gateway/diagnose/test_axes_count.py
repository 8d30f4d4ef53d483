"""Diagnosis of arms of four and of seven axes, by the command line: tables, recordings, and what was hidden in them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gateway.data.rows import MOVING
from gateway.data.table import write_csv
from sim.cellfile import read_cell
from sim.effects import apply_effects
from sim.nominal import plant_of
from sim.offline import PlannedVisit, Protocol, measure, point_jacobian
from sim.plant import Payload
from tests.cells import CELLS
from tests.data.arms import peer_of, sines, torque_of
from tests.support.rigs.command_line import run as command
from tests.support.rigs.tables import make_table, simulated_table

LOAD = Payload("tool", 3.0, np.array([0.05, -0.03, 0.06]))
SPRING = {"name": "balancer_spring", "joints": [2], "parameters": {"stiffness_n_m": 9000.0}}
SIGN = {"name": "sign_reversed", "joints": [3], "parameters": {}}
LISTS = ("noise_floor_nm", "friction_band_nm")


@pytest.fixture(params=CELLS, ids=lambda cell: cell.name)
def arm(request):
    return request.param


@pytest.fixture(autouse=True)
def _ledgers_apart(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def table(arm, path: Path, effects=(), poses: int = 16, seed: int = 5) -> Path:
    """Bare and loaded rest visits of the arm with effects built in, as the simulator has them."""
    spec = read_cell(arm.folder / "cell.toml").arms[0]
    plant = apply_effects(plant_of(spec), effects, point_jacobian(spec.chain))
    rng = np.random.default_rng(seed)
    q_rad = rng.uniform(0.85 * spec.chain.lower_rad, 0.85 * spec.chain.upper_rad, (poses, arm.axes))
    visits = [
        PlannedVisit(pose, label, 30.0 * pose + start, q)
        for label, start in (("none", 0.0), ("tool", 1000.0))
        for pose, q in enumerate(q_rad)
    ]
    columns = measure(spec.chain, plant, visits, {"tool": LOAD}, Protocol(settle=np.full(1, 0.2)), rng)
    write_csv(simulated_table(columns), path)
    return path


def diagnosed(arm, path: Path, *data: Path | str) -> tuple[int, dict, str]:
    said = command("diagnose", *data, "--cell", arm.folder / "cell.toml", "--json", path)
    return said.exit_code, json.loads(path.read_text()) if path.exists() else {}, said.output


def lists_of(body):
    """Every list that has a number per axis."""
    parts = (body["before"], body["after"])
    return [body[name] for name in LISTS] + [part[name] for part in parts for name in ("rms_nm", "holdout_rms_nm")]


@pytest.mark.slow
def test_an_arm_without_effects_needs_none(arm, tmp_path):
    code, body, said = diagnosed(arm, tmp_path / "out.json", table(arm, tmp_path / "run.csv"))
    assert code == 0, said
    assert body["verdict"] in ("none_needed", "undecided")
    assert body["effects"] == [] or body["verdict"] == "undecided"
    assert {len(values) for values in lists_of(body)} == {arm.axes}
    (load,) = body["loads"]
    assert load["frame"] == f"link_{arm.axes}"
    assert abs(load["mass_kg"] - LOAD.mass_kg) < max(4 * load["mass_std_kg"], 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("arm", CELLS[:1], ids=["four"], indirect=True)
def test_a_hidden_spring_is_named_with_its_joint(arm, tmp_path):
    code, body, said = diagnosed(arm, tmp_path / "out.json", table(arm, tmp_path / "run.csv", [SPRING]))
    assert code == 0, said
    assert ("balancer_spring", [2]) in [(effect["name"], effect["joints"]) for effect in body["effects"]], body
    assert body["verdict"] in ("explained", "improved", "undecided")
    assert {len(values) for values in lists_of(body)} == {arm.axes}
    (load,) = body["loads"]
    assert abs(load["mass_kg"] - LOAD.mass_kg) < max(5 * load["mass_std_kg"], 0.1)
    page = tmp_path / "page.html"
    assert command("report", tmp_path / "out.json", "-o", page).exit_code == 0
    assert f"J{arm.axes}" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_reversed_sign_is_a_failing_finding(arm, tmp_path):
    code, body, _ = diagnosed(arm, tmp_path / "out.json", table(arm, tmp_path / "run.csv", [SIGN]))
    assert code == 7
    assert any(finding["severity"] == "fail" and "J3" in finding["where"] for finding in body["findings"])


@pytest.mark.slow
def test_the_last_axis_is_looked_at_too(arm, tmp_path):
    """A cable on the last axis: the joints that an effect may act on go to N."""
    effect = {"name": "cable_torque", "joints": [arm.axes], "parameters": {"stiffness_nm_rad": 4.0}}
    code, body, said = diagnosed(
        arm, tmp_path / "out.json", table(arm, tmp_path / "run.csv", [effect]), "--only", "cable_torque"
    )
    assert code in (0, 7), said
    named = [joint for effect in body["effects"] for joint in effect["joints"]]
    assert arm.axes in named, body["effects"]


@pytest.mark.slow
@pytest.mark.parametrize("arm", CELLS[:1], ids=["four"], indirect=True)
def test_a_moving_run_is_diagnosed(arm, tmp_path):
    """A rigid arm with friction, its torque by the oracle of `tests/data/arms.py`, has nothing to name."""
    model, _ = peer_of(arm.urdf)
    time = np.linspace(0.0, 30.0, 1500)
    rate, size = np.linspace(0.7, 1.9, arm.axes)[None], 0.5 * np.minimum(arm.robot.upper_rad, 1.5)
    q, qd, qdd = sines(time, size, rate, np.arange(arm.axes))
    tau = torque_of(model, q, qd, qdd)
    rng = np.random.default_rng(2)
    tau += 5.0 * np.tanh(qd / 0.02) + 2.0 * qd + 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    path, out = tmp_path / "moving.csv", tmp_path / "out.json"
    count = len(time)
    write_csv(make_table(["none"] * count, [MOVING] * count, q, tau, time=time, qd=qd, qdd=qdd), path)
    said = command("diagnose", path, "--robot", arm.folder / "robot.urdf", "--json", out)
    assert said.exit_code == 0, said.output
    body = json.loads(out.read_text())
    assert body["verdict"] != "explained"
    assert {len(values) for values in lists_of(body)} == {arm.axes}


def test_a_table_of_another_arm_is_refused(arm, tmp_path):
    other = next(cell for cell in CELLS if cell is not arm)
    code, _, said = diagnosed(arm, tmp_path / "out.json", table(other, tmp_path / "run.csv"))
    assert code == 3
    assert f"{other.axes} axes" in said
    assert f"has {arm.axes}" in said
