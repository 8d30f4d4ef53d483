"""`plan --distinguish`: a named effect is stronger in tables measured at the chosen poses, by an own projection."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sim.cellfile import read_cell
from sim.effects import apply_effects
from sim.nominal import plant_of
from sim.offline import PlannedVisit, Protocol, gravity_columns, measure, point_jacobian
from sim.plant import Payload
from tests.support.rigs.command_line import run

CELL = Path(__file__).parents[3] / "examples" / "large" / "cell.toml"
ELASTIC = {"name": "joint_elasticity", "joints": [2], "parameters": {"compliance_rad_nm": 2e-6}}
LOADS = {"tool": Payload("tool", 60.0, np.array([0.05, 0.0, 0.15]))}


def seen_strength(poses, noise_nm):
    """Length over the noise of what an elastic J2 changes in measured tables, beyond links, load, gains and bias."""
    arm = read_cell(CELL).arms[0]
    plant = plant_of(arm)
    q = np.array([pose["q_rad"] for pose in poses if pose["purpose"] == "fit"])
    visits = [PlannedVisit(k, load, 30.0 * k, pose) for load in ("none", "tool") for k, pose in enumerate(q)]
    elastic = apply_effects(plant, [ELASTIC], point_jacobian(arm.chain))
    tables = [
        measure(arm.chain, each, visits, LOADS, Protocol(), np.random.default_rng(1))["tau_nm"].reshape(-1, 2, 6)
        for each in (elastic, plant)
    ]
    changed, torque = (tables[0] - tables[1]).mean(axis=1), tables[1].mean(axis=1)
    gravity = gravity_columns(arm.chain, q, np.array([0.0, 0.0, -9.80665]))
    links = np.concatenate([gravity, gravity])
    load = np.concatenate([np.zeros_like(gravity), gravity])[:, :, 20:]
    diagonal = torque[:, :, None] * np.eye(6)
    columns = np.concatenate([links, load, diagonal, np.broadcast_to(np.eye(6), diagonal.shape)], axis=2)
    weighted = (columns / np.array(noise_nm)[:, None]).reshape(-1, columns.shape[2])
    target = (changed / noise_nm).ravel()
    return float(np.linalg.norm(target - weighted @ np.linalg.lstsq(weighted, target, rcond=1e-9)[0]))


@pytest.mark.slow
def test_a_named_effect_is_stronger_in_the_same_time(tmp_path):
    files = {name: tmp_path / f"{name}.json" for name in ("standard", "chosen")}
    assert run("plan", CELL, "--json", files["standard"]).exit_code == 0
    done = run("plan", CELL, "--distinguish", "joint_elasticity,sign_reversed", "--json", files["chosen"])
    assert done.exit_code == 0, done.output
    assert "sign_reversed" in done.stderr
    standard, chosen = (json.loads(file.read_text(encoding="utf-8")) for file in files.values())
    assert [pose["purpose"] for pose in chosen["poses"]] == [pose["purpose"] for pose in standard["poses"]]
    assert chosen["duration_s"] <= 1.01 * standard["duration_s"]
    about = chosen["distinguish"]
    assert (about["effects"], about["not_shown_by_rest_poses"]) == (
        ["joint_elasticity", "sign_reversed"],
        ["sign_reversed"],
    )
    assert about["strength"]["joint_elasticity J2"] > about["standard_strength"]["joint_elasticity J2"]
    assert about["standard_expected"]["mass_std_kg"] == standard["expected"]["mass_std_kg"]
    assert chosen["expected"]["mass_std_kg"] < 1.5 * standard["expected"]["mass_std_kg"]
    noise_nm = standard["expected"]["noise_nm"]
    assert seen_strength(chosen["poses"], noise_nm) > 1.1 * seen_strength(standard["poses"], noise_nm)


@pytest.mark.parametrize(("words", "says"), [(["--distinguish", "nothing"], "base_tilt"), ([], "trajectories")])
def test_an_unknown_effect_and_a_moving_plan_are_usage_errors(words, says):
    done = run("plan", CELL, *(words or ["--distinguish", "base_tilt", "--moving"]))
    assert done.exit_code == 2
    assert says in done.stderr
