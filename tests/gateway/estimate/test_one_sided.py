"""Poses approached from one side: friction that grows with the transmitted torque is not taken for mass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.diagnose import diagnose
from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf
from tests.data.arms import carrying, peer_of, torque_of, urdf_of
from tests.support.rigs.tables import make_table

MASS, COM = 8.0, np.array([0.05, -0.03, 0.08])
LOSS, BAND = 0.10, 0.4
POSES = 16


def table(seed: int, sides: str):
    """Static torque by pinocchio, bare and with the load; every reading has `side (band + loss |torque|)` more.

    Approached from one side, so that motor and gravity are on opposite sides everywhere, or from alternating sides.
    """
    rng = np.random.default_rng(seed)
    text = urdf_of(rng)
    bare, _ = peer_of(text)
    poses = rng.uniform(-2.5, 2.5, (POSES, 6))
    rows, torque, direction = [], [], []
    for label in ("none", "tool"):
        for number, tau in enumerate(torque_of(bare if label == "none" else carrying(bare, MASS, COM), poses)):
            side = np.sign(tau) if sides == "lifting" else np.where(rng.random(6) < 0.5, 1.0, -1.0)
            torque.append(tau + side * (BAND + LOSS * np.abs(tau)) + 0.01 * rng.standard_normal(6))
            direction.append(side)
            rows.append((label, number))
    load, pose = zip(*rows, strict=True)
    measured = make_table(
        np.array(load), np.array(pose), np.tile(poses, (2, 1)), np.array(torque),
        time=25.0 * np.arange(2 * POSES), direction=np.array(direction), std=0.01, count=100,
    )  # fmt: skip
    return measured, robot_from_urdf(text, "random")


@pytest.mark.parametrize("sides", ["lifting", "by chance"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_friction_that_grows_with_the_torque_is_no_mass(seed: int, sides: str) -> None:
    measured, robot = table(seed, sides)
    options = Knowledge(link_std=0.02, gain_std=(0.0,) * 6)
    found = run(measured, robot, options).loads[0]
    assert abs(found.mass_kg - MASS) < 3.0 * found.mass_std_kg
    assert abs(found.mass_kg / MASS - 1.0) < 0.02
    assert found.mass_std_kg < 0.05 * MASS
    assert found.com_m == pytest.approx(COM, abs=0.003)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_friction_of_unknown_side_is_reported_and_widens_the_interval(seed: int) -> None:
    """All visits lift, and the table does not say so: friction looks like a tenth more mass."""
    measured, robot = table(seed, "lifting")
    measured = replace(measured, direction=np.zeros_like(measured.direction))
    found = run(measured, robot, Knowledge(link_std=0.05))
    (load,) = found.loads
    assert abs(load.mass_kg - MASS) < 1.96 * load.mass_std_kg
    (finding,) = [each for each in found.findings if each.where == "approach"]
    assert finding.severity == "warn"
    assert "friction cannot be separated from gravity" in finding.what


@pytest.mark.slow
def test_no_offset_is_named_where_no_side_is_known() -> None:
    measured, robot = table(1, "lifting")
    found = diagnose(replace(measured, direction=np.zeros_like(measured.direction)), robot)
    assert not {"torque_offset", "static_friction"} & {effect.name for effect in found.effects}
    assert any(each.where == "approach" and each.severity == "warn" for each in found.findings)


def test_the_load_friction_of_one_sided_visits_is_reported() -> None:
    measured, robot = table(1, "by chance")
    options = Knowledge(link_std=0.0, gain_std=(0.0,) * 6)
    found = run(measured, robot, options).nuisance["load_friction"]
    value, std = np.array(found.value), np.array(found.std)
    assert np.isfinite(value).all()
    assert (np.abs(value - LOSS) < 4.0 * std).all()
    assert value == pytest.approx(LOSS, abs=0.02)
