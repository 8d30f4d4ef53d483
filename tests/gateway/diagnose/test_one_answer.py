"""`estimate` and `diagnose` of one table: one answer where no effect is named, one refusal, one noise floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import MOVING, concatenate
from gateway.data.table import Table
from gateway.diagnose import diagnose
from gateway.errors import DataUnusable
from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.start_noise import negative_bands
from gateway.model.robot import Robot, robot_from_urdf
from gateway.result.result import Result
from tests.data.arms import carrying, peer_of, sines, torque_of, urdf_of
from tests.data.resting_arm import Bench
from tests.support.rigs.tables import make_table

#: No candidate of the search: a mistake alone, which is looked for only where the model does not fit.
NOTHING = frozenset({"axes_swapped"})


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(3, [], poses=8)


@pytest.fixture(scope="module")
def table(bench: Bench) -> Table:
    return bench.both()


def _knowledge(bench: Bench) -> Knowledge:
    return Knowledge(link_std=0.05, efficiency=tuple(bench.arm.efficiency.tolist()))


def test_loads_and_standard_deviations_are_equal_where_no_effect_is_named(bench: Bench, table: Table) -> None:
    options = Knowledge(efficiency=bench.arm.efficiency, gear_ratio=bench.arm.gear_ratio)
    found = diagnose(table, bench.robot, options, only=NOTHING)
    expected = run(table, bench.robot, _knowledge(bench))
    assert not found.effects
    np.testing.assert_allclose(found.friction_band_nm, expected.friction_band_nm, rtol=1e-9)
    for ours, other in zip(found.loads, expected.loads, strict=True):
        assert np.isclose(ours.mass_kg, other.mass_kg, rtol=1e-9)
        assert np.isclose(ours.mass_std_kg, other.mass_std_kg, rtol=1e-9)
        assert ours.com_m is not None
        assert other.com_m is not None
        assert np.allclose(ours.com_m, other.com_m, rtol=1e-9)
        assert np.allclose(ours.com_std_m, other.com_std_m, rtol=1e-9)


def test_a_table_with_outliers_is_searched_for_mistakes(bench: Bench, table: Table) -> None:
    """Half the poses have one approach: without the directions, other rows make a visit than with them."""
    single = (table.load == "tool") & (table.pose % 2 == 0)
    kept = table.take(~single | (table.direction[:, 1] == np.where(table.pose % 4 == 0, 1, -1)))
    touched = kept.tau_nm.copy()
    touched[np.flatnonzero((kept.load == "tool") & (kept.pose == 3)), 2] += 60.0
    only = frozenset({"axes_swapped", "static_friction"})
    found = diagnose(replace(kept, tau_nm=touched), bench.robot, bench.options, only=only)
    assert {(entry.joint, entry.pose) for entry in found.set_aside} == {(3, 3)}
    assert "static_friction" in {effect.name for effect in found.effects}
    assert abs(found.loads[0].mass_kg - bench.arm.loads["tool"].mass_kg) < 3.0 * found.loads[0].mass_std_kg


def test_one_posture_is_refused_by_both(bench: Bench, table: Table) -> None:
    one = table.take(np.asarray(table.pose) == table.pose[0])
    options = Knowledge(efficiency=bench.arm.efficiency, gear_ratio=bench.arm.gear_ratio)
    with pytest.raises(DataUnusable, match="one posture"):
        diagnose(one, bench.robot, options)
    with pytest.raises(DataUnusable, match="one posture"):
        run(one, bench.robot, _knowledge(bench))


def test_a_missing_effect_leaves_the_noise_floor_and_is_reported(bench: Bench, table: Table) -> None:
    clean = run(table, bench.robot, _knowledge(bench))
    size = 30.0 * max(clean.noise_floor_nm[1], 0.01)
    torque = table.motor_torque_nm if np.isnan(table.tau_nm).all() else table.tau_nm
    assert torque is table.tau_nm
    bent = table.tau_nm.copy()
    bent[:, 1] += size * np.sin(5.0 * table.q_rad[:, 1])
    wrong = run(replace(table, tau_nm=bent), bench.robot, _knowledge(bench))
    assert wrong.noise_floor_nm[1] < 3.0 * clean.noise_floor_nm[1]
    assert wrong.after.rms_nm[1] > 4.0 * wrong.noise_floor_nm[1]
    assert any(f.where == "J2" and "model error" in f.what and "diagnose" in f.advice for f in wrong.findings)
    assert not any("model error" in f.what for f in clean.findings)


def test_a_reversed_torque_sign_is_named_by_the_friction_band(bench: Bench, table: Table) -> None:
    clean = run(table, bench.robot, _knowledge(bench))
    assert not any("reversed" in f.what for f in clean.findings)
    for axes in ([3], list(range(table.axes))):
        turned = table.tau_nm.copy()
        turned[:, axes] *= -1.0
        found = run(replace(table, tau_nm=turned), bench.robot, _knowledge(bench))
        named = {f.where for f in found.findings if f.severity == "fail" and "reversed" in f.what}
        assert named == {", ".join(f"J{k + 1}" for k in axes)}


def test_a_band_whose_sign_the_data_do_not_determine_is_not_negative() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(-0.02, 0.1, (12, 3))
    half[:, 1] = rng.normal(-1.0, 0.1, 12)
    half[4:, 2] = np.nan
    assert negative_bands(half).tolist() == [False, True, False]


def _same(found: Result, expected: Result, count: int) -> None:
    """Loads with standard deviations and inertia, and gains, are equal to 1e-9."""
    assert not found.effects
    assert len(found.loads) == len(expected.loads) == count
    for ours, other in zip(found.loads, expected.loads, strict=True):
        assert ours.label == other.label
        for name in ("mass_kg", "mass_std_kg", "com_m", "com_std_m", "inertia_kg_m2", "inertia_std_kg_m2"):
            one, two = (np.array(getattr(load, name) or np.nan, dtype=float) for load in (ours, other))
            np.testing.assert_allclose(one, two, rtol=1e-9, err_msg=f"{ours.label}: {name}")
        assert np.isfinite(ours.mass_kg)
    for name, ours in found.nuisance.items():
        if name in expected.nuisance:
            np.testing.assert_allclose(ours.value, expected.nuisance[name].value, rtol=1e-9)
            np.testing.assert_allclose(ours.std, expected.nuisance[name].std, rtol=1e-9)


def _moving_loads(axes: int, count: int) -> dict[str, tuple[float, ...] | None]:
    rng = np.random.default_rng([axes, count])
    drawn = {f"load {k}": (rng.uniform(2.0, 6.0), *rng.uniform(-0.1, 0.1, 3)) for k in range(count)}
    return {"none": None, **drawn}


def _moving_arm(
    seed: int, axes: int, loads: Mapping[str, tuple[float, ...] | None], poses: int = 0
) -> tuple[Table, Robot]:
    """Runs of 8 s of a random chain: torque by pinocchio, Coulomb and viscous friction, white noise; and rest poses."""
    rng = np.random.default_rng([seed, axes])
    text = urdf_of(rng, axes=axes)
    model, _ = peer_of(text)
    time_s, tables = np.arange(0.0, 8.0, 0.02), []
    for number, (label, load) in enumerate(loads.items()):
        loaded = model if load is None else carrying(model, load[0], load[1:], 0.01 * load[0] * np.eye(3))
        omega, phase = rng.uniform(0.8, 2.5, (3, axes)), rng.uniform(0.0, 6.0, (3, axes))
        q, qd, qdd = sines(time_s, 0.4, omega, phase)
        tau = torque_of(loaded, q, qd, qdd)
        scale = np.maximum(np.abs(tau).max(axis=0), 1.0)
        tau += 0.1 * scale * np.tanh(qd / 0.02) + 0.03 * scale * qd + 0.01 * scale * rng.normal(size=tau.shape)
        rows = make_table([label] * len(time_s), [MOVING] * len(time_s), q, tau, time=time_s, qd=qd, qdd=qdd)
        tables.append(replace(rows, run=np.array([str(number)] * len(time_s))))
        if not poses:
            continue
        places = np.tile(rng.uniform(-1.5, 1.5, (poses, axes)), (2, 1))
        side = np.repeat([1.0, -1.0], poses)
        held = torque_of(loaded, places)
        held += 0.1 * scale * side[:, None] + 0.002 * scale * rng.normal(size=held.shape)
        tables.append(make_table([label] * 2 * poses, np.tile(np.arange(poses), 2), places, held, direction=side))
    return concatenate(tables), robot_from_urdf(text, f"{axes} axes")


@pytest.mark.slow
@pytest.mark.parametrize(("axes", "count"), [(2, 1), (6, 1), (6, 3), (7, 1)])
@pytest.mark.parametrize("seed", [0, 1])
def test_moving_loads_are_equal_where_no_effect_is_named(seed: int, axes: int, count: int) -> None:
    table, robot = _moving_arm(seed, axes, _moving_loads(axes, count))
    expected = run(table, robot, Knowledge(link_std=0.05))
    _same(diagnose(table, robot, Knowledge(link_std=0.05), only=NOTHING), expected, count)


def test_a_run_too_short_to_be_judged_gives_the_loads_of_the_estimate() -> None:
    table, robot = _moving_arm(0, 2, _moving_loads(2, 1))
    table = table.take(table.time_s < 1.5)
    expected = run(table, robot, Knowledge(link_std=0.05))
    found = diagnose(table, robot, only=NOTHING)
    assert found.verdict == "undecided"
    _same(found, expected, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_loads_of_rest_and_moving_rows_together_are_equal_where_no_effect_is_named(seed: int) -> None:
    table, robot = _moving_arm(seed, 6, _moving_loads(6, 1), poses=12)
    expected = run(table, robot, Knowledge(link_std=0.05))
    assert expected.motion
    _same(diagnose(table, robot, only=NOTHING), expected, 1)


def test_calibrated_constants_and_a_warm_arm_reach_the_loads_of_rest_and_moving_rows_together() -> None:
    table, robot = _moving_arm(0, 2, _moving_loads(2, 1), poses=12)
    stated = {"gain_std": (0.004,) * 2, "measured_gain": (True,) * 2, "change": 0.05}
    expected = run(table, robot, Knowledge(link_std=0.05, **stated))
    plain = run(table, robot, Knowledge(link_std=0.05))
    assert expected.motion
    assert expected.loads[0].mass_std_kg < 0.8 * plain.loads[0].mass_std_kg
    _same(diagnose(table, robot, Knowledge(**stated), only=NOTHING), expected, 1)
