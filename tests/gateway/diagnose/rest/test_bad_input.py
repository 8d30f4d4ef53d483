"""Tables that are not as they should be: a result, or a refusal with the reason; never a confident wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.table import Table, concatenate
from gateway.diagnose import diagnose
from gateway.errors import ConfigError, DataUnusable
from gateway.model.effects import MISTAKES
from gateway.result.result import Result
from tests.data.resting_arm import Bench, effect, found, undirected


@pytest.fixture(scope="module")
def healthy() -> tuple[Bench, Table, Result]:
    bench = Bench(3, [])
    table = bench.both()
    return bench, table, diagnose(table, bench.robot, bench.options)


def mass_of(result: Result, label: str = "tool") -> tuple[float, float]:
    load = next(load for load in result.loads if load.label == label)
    return load.mass_kg, load.mass_std_kg


# ----------------------------------------------------------------------------------------- how well constants are known


@pytest.mark.slow
def test_constants_that_are_known_exactly_are_taken_at_their_word(healthy):
    bench, table, _ = healthy
    result = diagnose(table, bench.robot, replace(bench.options, gain_std=(0.0,) * 6))
    assert result.verdict == "none_needed"
    mass, std = mass_of(result)
    assert abs(mass - bench.arm.loads["tool"].mass_kg) < 3.0 * std
    assert 0.0 < std < 0.03 * mass, "gains still change from the unloaded to the loaded occasion"


def test_barely_known_constants_are_refused_with_the_reason(healthy):
    bench, table, _ = healthy
    with pytest.raises(ConfigError, match=r"known to 50 % does not determine a mass.*--known"):
        diagnose(table, bench.robot, replace(bench.options, gain_std=(0.03,) * 5 + (0.5,)))
    with pytest.raises(ConfigError, match="5 standard deviations of torque constants for an arm of 6 axes"):
        diagnose(table, bench.robot, replace(bench.options, gain_std=(0.03,) * 5))
    for wrong in (-0.01, float("nan")):
        with pytest.raises(ConfigError, match=f"share of 0 or more, not {wrong}"):
            diagnose(table, bench.robot, replace(bench.options, gain_std=(wrong,) * 6))


# ------------------------------------------------------------------------------------------------------- outlier visits


def with_outliers(table: Table, bench: Bench, entries: list[tuple[int, int]], bands: float = 6.0) -> Table:
    """The table with both sides of some visits pushed by so many friction bands on one axis."""
    torque = table.tau_nm.copy()
    for visit, axis in entries:
        torque[2 * visit : 2 * visit + 2, axis] += bands * bench.arm.plant.coulomb_nm[axis]
    return replace(table, tau_nm=torque)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 6])
def test_outlier_visits_are_rejected_listed_and_barely_change_the_answer(seed):
    bench = Bench(seed, [])
    table = bench.both()
    sound = diagnose(table, bench.robot, bench.options)
    result = diagnose(with_outliers(table, bench, [(4, 2), (13, 1)]), bench.robot, bench.options)
    assert sorted((rejected.load, rejected.pose, rejected.joint) for rejected in result.set_aside) == [
        ("none", 4, 3),
        ("tool", 3, 2),
    ]
    for rejected in result.set_aside:
        assert rejected.bands == pytest.approx(6.0, rel=0.5)
        assert rejected.reason
    (words,) = [each.what for each in result.findings if each.where == "outliers"]
    assert words.startswith("2 outliers are in no fit")
    assert "pose 4 under none, J3 by" in words
    assert "pose 3 under tool, J2 by" in words
    assert found(result) == found(sound)
    assert result.verdict == sound.verdict == "none_needed"
    mass, std = mass_of(sound)
    assert abs(mass_of(result)[0] - mass) < 0.5 * std
    moved = np.array(result.loads[0].com_m) - np.array(sound.loads[0].com_m)
    assert np.all(np.abs(moved) < 0.5 * np.array(sound.loads[0].com_std_m))


@pytest.mark.slow
def test_an_effect_is_named_beside_outlier_visits():
    bench = Bench(4, [effect("base_tilt", [], tilt_x_rad=0.05, tilt_y_rad=0.03)])
    result = diagnose(with_outliers(bench.both(), bench, [(6, 1)]), bench.robot, bench.options)
    assert found(result) == [("base_tilt", ())]
    assert [(rejected.pose, rejected.joint) for rejected in result.set_aside] == [(6, 2)]


def test_where_every_visit_is_an_outlier_none_is_rejected_and_that_is_reported(healthy):
    bench, table, sound = healthy
    rng = np.random.default_rng(0)
    push = rng.uniform(4.0, 10.0, table.tau_nm.shape) * rng.choice([-1.0, 1.0], table.tau_nm.shape)
    wild = replace(table, tau_nm=table.tau_nm + push * bench.arm.plant.coulomb_nm)
    result = diagnose(wild, bench.robot, bench.options)
    assert result.set_aside == ()
    words = [each for each in result.findings if "outliers cannot be identified on these axes" in each.what]
    assert len(words) == 1
    assert words[0].severity == "warn"
    # what it says of the load, it says with as much uncertainty as the visits scatter
    load, tool = result.loads[0], bench.arm.loads["tool"]
    assert load.refused or abs(load.mass_kg - tool.mass_kg) < 3.0 * load.mass_std_kg
    assert load.mass_std_kg > 2.0 * mass_of(sound)[1]


# ----------------------------------------------------------------------------------------------------- what is held out


@pytest.mark.slow
def test_held_out_rows_of_another_arm_are_not_met(healthy):
    bench, table, _ = healthy
    other = Bench(7, [])
    other.poses = bench.poses[:4] + 0.1
    held = other.both()
    result = diagnose(table, bench.robot, bench.options, holdout=held)
    assert result.verdict not in ("explained", "none_needed")
    words = [each.what for each in result.findings if each.where == "hold-out"]
    assert len(words) == 1
    assert "poses that were not used in the fit deviate by more than the noise" in words[0]
    # and it has not been taken for a word on the load
    assert mass_of(result) == pytest.approx(mass_of(diagnose(table, bench.robot, bench.options)))


def test_held_out_rows_of_the_same_arm_are_met(healthy):
    bench, table, _ = healthy
    held = concatenate([bench.table(bench.poses[:4] + 0.1, load, 50) for load in ("none", "tool")])
    result = diagnose(table, bench.robot, bench.options, holdout=held)
    assert result.verdict == "none_needed"
    assert not [each for each in result.findings if each.where == "hold-out"]


def test_held_out_rows_with_another_load_alone_are_refused(healthy):
    bench, table, _ = healthy
    held = bench.table(bench.poses[:4] + 0.1, "tool", 50)
    held = replace(held, load=np.full(len(held.load), "gripper"))
    with pytest.raises(DataUnusable, match="carry no load that is in the data"):
        diagnose(table, bench.robot, bench.options, holdout=held)


# --------------------------------------------------------------------------------------------------------- several runs


@pytest.mark.slow
def test_a_run_of_a_tenth_of_the_others_changes_no_answer():
    bench = Bench(3, [], poses=10)
    long = [bench.table(bench.poses, load, run=run) for run in ("a", "b") for load in ("none", "tool")]
    short = bench.table(bench.poses[:2], "tool", run="c")
    named, tables = frozenset({"base_tilt", "cable_torque"}), (concatenate([*long, short]), concatenate(long))
    both, alone = (diagnose(table, bench.robot, bench.options, only=named) for table in tables)
    assert both.verdict == alone.verdict == "none_needed"
    mass, std = mass_of(alone)
    assert abs(mass_of(both)[0] - mass) < 0.5 * std
    assert mass_of(both)[1] == pytest.approx(std, rel=0.15)


def test_a_load_of_one_run_alone_is_reported_with_its_own_uncertainty():
    """Two loads, one measured in each of two runs, the second at four poses only."""
    bench = Bench(3, [], poses=10)
    tool = bench.arm.loads["tool"]
    lighter = replace(tool, mass_kg=0.5 * tool.mass_kg)
    parts = [bench.table(bench.poses, load, run="a") for load in ("none", "tool")]
    bench.arm = replace(bench.arm, loads=bench.arm.loads | {"gripper": lighter})
    parts.append(bench.table(bench.poses[:4], "gripper", run="b"))
    result = diagnose(concatenate(parts), bench.robot, bench.options)
    assert result.verdict == "none_needed"
    for label, true_kg in (("tool", tool.mass_kg), ("gripper", lighter.mass_kg)):
        mass, std = mass_of(result, label)
        assert abs(mass - true_kg) < 3.0 * std
        assert std < 0.2 * true_kg


# -------------------------------------------------------------------------------------------------- without a direction


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 8])
def test_a_table_without_directions_names_no_wiring_mistake(seed):
    bench = Bench(seed, [])
    result = diagnose(undirected(bench.both()), bench.robot, bench.options)
    assert not {name for name, _ in found(result)} & set(MISTAKES)
    assert not result.failed
    tool = bench.arm.loads["tool"]
    mass, std = mass_of(result)
    assert abs(mass - tool.mass_kg) < 3.0 * std
