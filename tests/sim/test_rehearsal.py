"""Arms of a cell drawn for a rehearsal: the same from the same seed, near the wanted strength, a real table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.data.table import Table, read_csv
from sim.cellfile import CellFileError
from sim.rehearsal import answered

LARGE = Path(__file__).parents[2] / "examples" / "large" / "cell.toml"


def measured(folder: Path, **stated: Any) -> tuple[Table, dict[str, Any]]:
    """Table and truth of an arm of the large cell at five postures."""
    low, high = np.array([-2.9, -1.0, -1.2, -3.0, -2.0, -3.0]), np.array([2.9, 1.2, 1.4, 3.0, 2.0, 3.0])
    q_rad = np.random.default_rng(0).uniform(low, high, (5, 6)).tolist()
    usual = {"seed": 1, "load": 0, "effect": None, "joints": [], "strength": 3.0, "link_std": 0.05}
    sizes = {"q_rad": q_rad, "visit_s": 9.0, "largest_kg": 120.0, "gain_std": [0.03] * 6}
    truth = answered(LARGE, None, {"table": str(folder / "table.csv"), **usual, **sizes, **stated})
    return read_csv(folder / "table.csv", None), truth


def test_table_has_each_pose_from_both_sides_without_and_with_the_load(tmp_path: Path) -> None:
    table, truth = measured(tmp_path)
    assert len(table) == 5 * 2 * 2
    assert set(table.load.tolist()) == {"none", truth["load"]}
    assert set(np.unique(table.direction).tolist()) == {-1, 1}
    assert 0.3 * 120.0 <= truth["mass_kg"] <= 120.0
    again, same = measured(tmp_path)
    assert np.array_equal(table.tau_nm, again.tau_nm)
    assert same == truth


def test_another_load_hangs_on_the_same_arm(tmp_path: Path) -> None:
    (first, one), (second, two) = measured(tmp_path), measured(tmp_path, load=1)
    (other, _) = measured(tmp_path, seed=2)
    bare = first.load == "none"
    assert one["mass_kg"] != two["mass_kg"]

    def apart(table: Table) -> float:
        return float(np.abs(table.tau_nm[bare] - first.tau_nm[bare])[:, 1].mean())

    assert apart(second) < 0.5 * apart(other), "the unloaded arm is the same but for the day"


@pytest.mark.parametrize(("effect", "joints"), [("base_tilt", []), ("cable_torque", [4])])
def test_effect_grows_with_the_strength_wanted(tmp_path: Path, effect: str, joints: list[int]) -> None:
    sizes = []
    for wanted in (1.0, 4.0):
        _, truth = measured(tmp_path, effect=effect, joints=joints, strength=wanted)
        assert truth["strength"] == pytest.approx(wanted, rel=0.1)
        sizes.append(truth["size"])
    assert sizes[1] == pytest.approx(4.0 * sizes[0], rel=0.15)


def test_zero_offset_turns_the_gravity_torque_as_its_size_says(tmp_path: Path) -> None:
    # friction and noise are the same; a turned last link leaves the vertical axis 1 without a torque
    without, _ = measured(tmp_path)
    with_it, truth = measured(tmp_path, effect="joint_zero_offset", joints=[5], strength=5.0)
    assert truth["parameter"] == "offset_rad"
    change = np.abs(with_it.tau_nm - without.tau_nm).max(axis=0)
    assert change[4] > 10.0 * change[0]


def test_places_of_effects_and_refusals(tmp_path: Path) -> None:
    places = answered(LARGE, None, {})
    assert places["base_tilt"] == [[]]
    assert [2] in places["balancer_spring"]
    with pytest.raises(ValueError, match="base_tilt"):
        measured(tmp_path, effect="base_tilt", joints=[3])
    with pytest.raises(CellFileError, match="arm"):
        answered(LARGE, "other", {})
