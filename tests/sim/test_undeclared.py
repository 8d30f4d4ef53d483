"""What a seed builds into an arm on the bus: one effect, none or two, of the strength that counts, in the truth."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from sim.build_errors import with_build_errors
from sim.cellfile import read_payloads
from sim.draw_effects import MISTAKES
from sim.effects import apply_effects
from sim.nominal import plant_of
from sim.offline import point_jacobian
from sim.plant import Payload
from sim.serve import running
from sim.simulation import CellFileError, ServeOptions, Simulation
from sim.undeclared import draw_undeclared

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SMALL = EXAMPLES / "small" / "cell.toml"
PAYLOAD = EXAMPLES / "small" / "payload.toml"
WITH_EFFECT, WITHOUT = 2, 3


@pytest.fixture
def drawn(arm_of):
    """Effects drawn for the small arm by seed."""
    arm, loads = arm_of("small"), read_payloads(PAYLOAD)

    def draw(seed: int, loads: dict[str, Payload] = loads):
        plant = with_build_errors(plant_of(arm), arm.chain, seed)
        effects = draw_undeclared(arm, plant, loads, seed)
        apply_effects(plant, effects, point_jacobian(arm.chain))
        return effects

    return draw


@pytest.mark.slow
def test_one_effect_none_or_two_of_a_strength_that_counts(drawn):
    cells = [drawn(seed) for seed in range(18)]
    count = Counter(len(effects) for effects in cells)
    assert set(count) == {0, 1, 2}
    assert count[1] > count[2]
    for effects in cells:
        names = [effect["name"] for effect in effects]
        assert len(set(names)) == len(names)
        for effect in effects:
            if effect["name"] in MISTAKES:
                assert "strength" not in effect
                assert len(effects) == 1
            else:
                assert 1.5 <= effect["strength"] < 30.0


@pytest.mark.slow
def test_a_seed_draws_the_same_again_and_needs_no_load(drawn):
    assert drawn(WITH_EFFECT) == drawn(WITH_EFFECT)
    for seed in range(6):
        assert all(effect["name"] != "payload_shift" for effect in drawn(seed, {}))


def test_truth_and_plant_hold_what_was_drawn(tmp_path, channel):
    truth = tmp_path / "truth.json"
    for seed, count in ((WITH_EFFECT, 1), (WITHOUT, 0)):
        with running(SMALL, f"virtual:{channel}", payload=PAYLOAD, seed=seed, truth=truth) as simulation:
            written = json.loads(truth.read_text(encoding="utf-8"))
            assert len(written["effects"]) == count
            assert simulation.simulation.effects == written["effects"]
            assert written["loads"][0]["label"] == "gripper"
            plant = simulation.simulation.arms[0].world.plant
            assert np.any(plant.load_friction > 0) == (count == 1)


def test_a_file_of_effects_can_ask_for_build_errors_too(tmp_path, channel, arm_of):
    arm = arm_of("small")
    path = tmp_path / "effects.toml"
    path.write_text(
        'build_errors = 4\n[[effect]]\nname = "torque_offset"\njoints = [3]\nparameters = {offset_nm = 2}\n'
    )
    with running(SMALL, f"virtual:{channel}", undeclared=path) as simulation:
        plant = simulation.simulation.arms[0].world.plant
    wanted = with_build_errors(plant_of(arm), arm.chain, 4)
    np.testing.assert_array_equal(plant.link_mass_kg, wanted.link_mass_kg)
    assert plant.reading_offset_nm[2] == 2.0
    path.write_text("build_errors = true\n")
    with pytest.raises(CellFileError, match="build_errors is the seed"):
        Simulation(SMALL, ServeOptions(bus=f"virtual:{channel}", undeclared=path))
