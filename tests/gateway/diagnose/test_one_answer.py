"""`estimate` and `diagnose` of one table at rest: one answer where no effect is named, one refusal, one noise floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.table import Table
from gateway.diagnose import DiagnoseOptions, diagnose
from gateway.errors import DataUnusable
from gateway.estimate import EstimateOptions, run
from gateway.identify.repeats import negative_bands
from tests.resting_arm import Bench

#: No candidate of the search: a mistake alone, which is looked for only where the model does not fit.
NOTHING = frozenset({"axes_swapped"})


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(3, [], poses=8)


@pytest.fixture(scope="module")
def table(bench: Bench) -> Table:
    return bench.both()


def _estimate_options(bench: Bench) -> EstimateOptions:
    return EstimateOptions(inertials="prior:0.05", efficiency=tuple(bench.arm.efficiency.tolist()))


def test_loads_and_standard_deviations_are_equal_where_no_effect_is_named(bench: Bench, table: Table) -> None:
    options = DiagnoseOptions(efficiency=bench.arm.efficiency, gear_ratio=bench.arm.gear_ratio, only=NOTHING)
    found = diagnose(table, bench.robot, options)
    expected = run(table, bench.robot, _estimate_options(bench))
    assert not found.effects
    for ours, other in zip(found.loads, expected.loads, strict=True):
        assert np.isclose(ours.mass_kg, other.mass_kg, rtol=1e-9)
        assert np.isclose(ours.mass_std_kg, other.mass_std_kg, rtol=1e-9)
        assert ours.com_m is not None
        assert other.com_m is not None
        assert np.allclose(ours.com_m, other.com_m, rtol=1e-9)
        assert np.allclose(ours.com_std_m, other.com_std_m, rtol=1e-9)


def test_one_posture_is_refused_by_both(bench: Bench, table: Table) -> None:
    one = table.take(np.asarray(table.pose) == table.pose[0])
    options = DiagnoseOptions(efficiency=bench.arm.efficiency, gear_ratio=bench.arm.gear_ratio)
    with pytest.raises(DataUnusable, match="one posture"):
        diagnose(one, bench.robot, options)
    with pytest.raises(DataUnusable, match="one posture"):
        run(one, bench.robot, _estimate_options(bench))


def test_a_missing_effect_leaves_the_noise_floor_and_is_reported(bench: Bench, table: Table) -> None:
    clean = run(table, bench.robot, _estimate_options(bench))
    size = 30.0 * max(clean.noise_floor_nm[1], 0.01)
    torque = table.motor_torque_nm if np.isnan(table.tau_nm).all() else table.tau_nm
    assert torque is table.tau_nm
    bent = table.tau_nm.copy()
    bent[:, 1] += size * np.sin(5.0 * table.q_rad[:, 1])
    wrong = run(replace(table, tau_nm=bent), bench.robot, _estimate_options(bench))
    assert wrong.noise_floor_nm[1] < 3.0 * clean.noise_floor_nm[1]
    assert wrong.after.rms_nm[1] > 4.0 * wrong.noise_floor_nm[1]
    assert any(f.where == "J2" and "model error" in f.what and "diagnose" in f.advice for f in wrong.findings)
    assert not any("model error" in f.what for f in clean.findings)


def test_a_reversed_torque_sign_is_named_by_the_friction_band(bench: Bench, table: Table) -> None:
    clean = run(table, bench.robot, _estimate_options(bench))
    assert not any("reversed" in f.what for f in clean.findings)
    for axes in ([3], list(range(table.axes))):
        turned = table.tau_nm.copy()
        turned[:, axes] *= -1.0
        found = run(replace(table, tau_nm=turned), bench.robot, _estimate_options(bench))
        named = {f.where for f in found.findings if f.severity == "fail" and "reversed" in f.what}
        assert named == {", ".join(f"J{k + 1}" for k in axes)}


def test_a_band_whose_sign_the_data_do_not_determine_is_not_negative() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(-0.02, 0.1, (12, 3))
    half[:, 1] = rng.normal(-1.0, 0.1, 12)
    half[4:, 2] = np.nan
    assert negative_bands(half).tolist() == [False, True, False]
