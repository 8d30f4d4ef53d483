"""Periods of an excitation: parameters come back, noise is from differences, a touched period is rejected."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.periods import MOTION_HZ
from gateway.data.rows import MOVING, concatenate
from gateway.errors import DataUnusable
from gateway.estimate import estimate, run
from gateway.identify.knowledge import Knowledge
from gateway.identify.motion.columns import MovingSetup, moving_columns
from gateway.model.robot import link_lengths_m, robot_from_urdf
from tests.data.arms import carrying, peer_of, sines, torque_of
from tests.data.moving_arm import as_period, coloured
from tests.gateway.estimate.conftest import urdf
from tests.support.rigs.tables import make_table

MASS, COM = 6.0, np.array([0.1, -0.03, 0.06])
TENSOR = np.array([[0.09, 0.01, -0.015], [0.01, 0.07, 0.008], [-0.015, 0.008, 0.12]])
SIX = TENSOR[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
COULOMB = np.array([20.0, 25.0, 15.0, 4.0, 3.0, 2.0])
VISCOUS = np.array([10.0, 12.0, 8.0, 2.0, 1.5, 1.0])
ROTOR = np.array([8.0, 8.0, 5.0, 1.0, 0.6, 0.3])
DELAY = np.array([0.004, 0.003, 0.006, 0.002, 0.005, 0.004])
LOSS = 0.04
PERIOD_S, RATE_HZ = 8.0, 100.0
PHASE_S = np.arange(round(PERIOD_S * RATE_HZ)) / RATE_HZ
EXACT = Knowledge(link_std=0.0, gain_std=(0.0,) * 6)


def states(time_s):
    """A series of five harmonics, all joints, at any time."""
    rng = np.random.default_rng(3)
    rate = 2 * np.pi * np.arange(1, 6)[:, None] / PERIOD_S
    return sines(time_s, rng.uniform(0.1, 0.35, (5, 6)), rate, rng.uniform(0, 6, (5, 6)))


def model_of(loaded):
    """Pinocchio's model of the arm, with the load or without."""
    model, _ = peer_of(urdf())
    return carrying(model, MASS, COM, TENSOR) if loaded else model


def torque(time_s, loaded, delay_s):
    """What drives report that lag, each axis by its own delay."""
    out = np.empty((len(time_s), 6))
    for axis, delay in enumerate(delay_s):
        q, qd, qdd = states(time_s - delay)
        rigid = torque_of(model_of(loaded), q, qd, qdd)[:, axis]
        speed = qd[:, axis]
        dry = (COULOMB[axis] + LOSS * np.abs(rigid)) * np.tanh(speed / 0.02)
        out[:, axis] = rigid + dry + VISCOUS[axis] * speed + ROTOR[axis] * qdd[:, axis]
    return out


@pytest.fixture(scope="module")
def clean():
    """One period of the torque of the bare and of the loaded arm, lagging."""
    return {label: torque(PHASE_S, label == "tool", DELAY) for label in ("none", "tool")}


def table_of_periods(tau, noise_nm=0.0, periods=3, seed=0):
    """Periods one after the other: `tau` label -> (n, 6)."""
    rng, count = np.random.default_rng(seed), len(PHASE_S)
    q, qd, qdd = states(PHASE_S)
    parts = []
    for label, clean in tau.items():
        one = make_table(
            [label] * count, [MOVING] * count, q, clean,
            time=PHASE_S - PERIOD_S, qd=qd, qdd=qdd, run=[label] * count,
        )  # fmt: skip
        for period in range(1, periods + 1):
            torque = clean + noise_nm * coloured(rng, clean.shape, RATE_HZ)
            parts.append(as_period(one, torque, 7.0, period, PERIOD_S))
    return concatenate(parts)


@pytest.fixture(scope="module")
def robot():
    return robot_from_urdf(urdf(), "twelve.urdf")


def numbers(result, name):
    return np.array([getattr(one, name) for one in result.motion])


def test_all_that_motion_determines_comes_back_without_noise(clean, robot):
    result = run(table_of_periods(clean), robot, EXACT)
    load = result.loads[0]
    assert load.mass_kg == pytest.approx(MASS, rel=3e-3)
    np.testing.assert_allclose(load.com_m, COM, atol=1e-3)
    np.testing.assert_allclose(load.inertia_kg_m2, SIX, atol=3e-3)
    assert load.unidentifiable == ()
    np.testing.assert_allclose(numbers(result, "coulomb_nm"), COULOMB, rtol=0.02)
    np.testing.assert_allclose(numbers(result, "viscous_nm_s_rad"), VISCOUS, rtol=0.03)
    np.testing.assert_allclose(numbers(result, "rotor_inertia_kg_m2"), ROTOR, rtol=0.02)
    np.testing.assert_allclose(numbers(result, "delay_s")[:5], DELAY[:5], atol=3e-4)
    assert numbers(result, "delay_s")[5] == pytest.approx(DELAY[5], abs=3e-3)  # nearly all of its torque is friction
    assert [one.joint for one in result.motion] == [1, 2, 3, 4, 5, 6]
    assert all(one.speed_rad_s > 0.1 for one in result.motion)
    assert result.set_aside == ()


@pytest.mark.slow
def test_the_order_of_the_rows_does_not_matter(clean, robot):
    table = table_of_periods(clean, 0.3)
    mixed = table.take(np.random.default_rng(5).permutation(len(table)))
    one, other = (run(rows, robot, EXACT).loads[0] for rows in (table, mixed))
    assert one.mass_kg == pytest.approx(other.mass_kg, rel=1e-6)
    np.testing.assert_allclose(one.inertia_kg_m2, other.inertia_kg_m2, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(one.inertia_std_kg_m2, other.inertia_std_kg_m2, rtol=1e-2)


@pytest.mark.slow
def test_intervals_hold_under_coloured_noise(clean, robot):
    """Noise that is autocorrelated over five rows, 6 draws of ten numbers and of the friction of six axes."""
    truth = np.array([MASS, *COM, *SIX])
    size = np.array([2.0, 2.0, 1.0, 0.3, 0.2, 0.2])
    inside, axes = [], []
    for seed in range(6):
        result = run(table_of_periods(clean, size, seed=seed), robot, EXACT)
        load = result.loads[0]
        value = np.array([load.mass_kg, *load.com_m, *load.inertia_kg_m2])
        std = np.array([load.mass_std_kg, *load.com_std_m, *load.inertia_std_kg_m2])
        inside.append(np.abs(value - truth) < 1.96 * std)
        off = (numbers(result, "coulomb_nm") - COULOMB) / numbers(result, "coulomb_std_nm")
        axes.append(np.abs(off) < 1.96)
    assert np.mean(inside) > 0.87
    assert np.mean(axes) > 0.85


def test_friction_that_differs_between_runs_is_that_of_the_arm(clean, robot):
    """Levels of 10 % in each run; the scatter follows from all axes, and without one the intervals stay narrow."""
    dry = COULOMB * np.tanh(np.column_stack([states(PHASE_S - delay)[1][:, k] for k, delay in enumerate(DELAY)]) / 0.02)
    level = 0.1 * np.random.default_rng(8).normal(size=(2, 6))
    runs = {label: tau + share * dry for (label, tau), share in zip(clean.items(), level, strict=True)}
    equal, scattered = (run(table_of_periods(tau, 0.3, seed=2), robot, EXACT) for tau in (clean, runs))
    off = (numbers(scattered, "coulomb_nm") - COULOMB) / numbers(scattered, "coulomb_std_nm")
    assert (np.abs(off) < 2.5).all()
    share = numbers(scattered, "coulomb_std_nm") / COULOMB
    assert (share > 0.04).all()
    assert (numbers(equal, "coulomb_std_nm") < 0.5 * share * COULOMB)[:3].all()
    load = scattered.loads[0]  # the readings of both recordings may differ by 0.5 %
    assert abs(load.mass_kg - MASS) < 1.96 * load.mass_std_kg < 0.02 * MASS


def test_torque_is_filtered_as_the_motion_is(clean, robot):
    """An oscillation above the band of the motion widens no interval."""
    swing = 0.5 * COULOMB * np.sin(2 * np.pi * 12.0 * PHASE_S)[:, None]
    table = table_of_periods({label: tau + swing for label, tau in clean.items()}, 0.1)
    said = replace(table, extra={**table.extra, MOTION_HZ: np.full(len(table), 10.0)})
    plain, filtered = (run(one, robot, EXACT) for one in (table, said))
    assert filtered.loads[0].mass_kg == pytest.approx(MASS, rel=3e-3)
    for name in ("coulomb_std_nm", "viscous_std_nm_s_rad"):
        assert (numbers(filtered, name) < numbers(plain, name)).mean() > 0.5, name


def falling(time_s, share, speed_rad_s, power):
    """What breakaway friction adds, which falls with a power of the speed, on a drive that does not lag."""
    speed = states(time_s)[1]
    return share * COULOMB * np.exp(-((np.abs(speed) / speed_rad_s) ** power)) * np.sign(speed)


@pytest.mark.parametrize(("speed_rad_s", "power"), [(0.02, 1.0), (0.06, 1.0), (0.03, 2.0), (0.08, 1.5)])
def test_a_fall_from_breakaway_of_any_shape_is_not_taken_for_coulomb_friction(clean, robot, speed_rad_s, power):
    more = falling(PHASE_S, 0.4, speed_rad_s, power)
    table = table_of_periods({label: tau + more for label, tau in clean.items()}, noise_nm=1.5, seed=4)
    result = run(table, robot, EXACT)
    truths = {"coulomb_{}nm": COULOMB, "viscous_{}nm_s_rad": VISCOUS}
    for name, truth in truths.items():
        off = np.abs(numbers(result, name.format("")) - truth)
        assert (off < 2.1 * numbers(result, name.format("std_")))[:3].all(), name
        assert (off < 0.07 * truth)[:3].all(), name
    breakaway = numbers(result, "breakaway_nm") / COULOMB
    assert breakaway[0] == pytest.approx(1.4, abs=0.2)
    assert np.isfinite(breakaway).sum() == np.isfinite(numbers(result, "stribeck_rad_s")).sum()


@pytest.mark.slow
def test_torques_without_stated_constants_may_all_share_one_error(clean, robot):
    """A factor of all torques moves the mass by as much: half of the variance is common, stated or not."""
    table, rough = table_of_periods(clean, noise_nm=0.3, seed=4), replace(EXACT, link_std=0.05)
    by_std = {std: run(table, robot, replace(rough, gain_std=std)).loads[0] for std in (None, (0.03,) * 6)}
    assert by_std[None].mass_std_kg == pytest.approx(by_std[(0.03,) * 6].mass_std_kg)
    assert 0.03 * MASS / np.sqrt(6.0) < by_std[None].mass_std_kg < 0.04 * MASS
    assert sum(by_std[None].budget.values()) == pytest.approx(1.0)


def test_links_that_share_one_error_are_known_by_their_masses(clean, robot):
    """A factor of every link looks like a gain of all axes: ten numbers of a link determine it once, not ten times."""
    trust, options = 0.05, Knowledge(link_std=0.05)
    columns = moving_columns(table_of_periods(clean, periods=1), robot, options, MovingSetup())
    factor = np.where(np.arange(len(columns.names)) < columns.bodies, columns.prior.mean, 0.0)
    known = (factor @ columns.prior.precision @ factor) ** -0.5
    six = robot.inertia_kg_m2[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    size = six / (robot.mass_kg * link_lengths_m(robot) ** 2)[:, None]
    assert known == pytest.approx(trust / np.sqrt(6.0 + (size**2).sum()))


def test_a_touched_period_is_rejected_and_changes_nothing(clean, robot):
    table = table_of_periods(clean, 0.3, periods=4)
    touched = table.tau_nm.copy()
    rows = np.flatnonzero((np.asarray(table.load) == "tool") & (table.extra["x_period"] == 2.0))[200:260]
    touched[rows, 1] += 60.0
    result = run(replace(table, tau_nm=touched), robot, EXACT)
    plain = run(table, robot, EXACT)
    (entry,) = result.set_aside
    assert (entry.run, entry.load, entry.joint) == ("tool", "tool", 2)
    assert entry.from_s < 8.0 + 2.3 < entry.to_s
    assert any("rejected" in finding.what for finding in result.findings)
    assert plain.set_aside == ()
    assert result.loads[0].mass_kg == pytest.approx(plain.loads[0].mass_kg, abs=3 * plain.loads[0].mass_std_kg)
    np.testing.assert_allclose(result.loads[0].com_m, plain.loads[0].com_m, atol=2e-3)


def test_a_load_that_slips_during_the_run_is_refused(clean, robot):
    table = table_of_periods(clean, 0.3, periods=5)
    delay = (np.asarray(table.load) == "tool") & (table.extra["x_period"] >= 3)
    moved = table.tau_nm.copy()
    moved[delay] += 0.15 * np.tile(clean["tool"] - clean["none"], (3, 1))
    result = run(replace(table, tau_nm=moved), robot, EXACT)
    (load,) = result.loads
    assert np.isnan(load.mass_kg)
    assert "from period 3 on" in load.refused
    assert result.failed


def test_one_period_is_reported_to_determine_no_noise(clean, robot):
    found = estimate(table_of_periods(clean, 0.3, periods=1), robot, EXACT)
    assert any("fewer than two whole periods" in finding.what for finding in found.findings)


def test_a_drive_with_a_delay_is_named(clean, robot):
    delay = DELAY.copy()
    delay[2] = 0.04
    tau = {label: torque(PHASE_S, label == "tool", delay) for label in ("none", "tool")}
    result = run(table_of_periods(tau, 0.1), robot, EXACT)
    assert numbers(result, "delay_s")[2] == pytest.approx(0.04, abs=0.003)
    (said,) = [finding for finding in result.findings if "after the position" in finding.what]
    assert said.where == "J3"


def test_a_motion_that_was_sampled_too_slowly_is_refused(clean, robot):
    table = table_of_periods(clean)
    few = table.take(np.arange(0, len(table), 100))
    with pytest.raises(DataUnusable, match="sampled"):
        run(few, robot, EXACT)


def test_speeds_in_degrees_are_refused(clean, robot):
    table = table_of_periods(clean)
    with pytest.raises(DataUnusable, match="speed"):
        run(replace(table, qd_rad_s=np.degrees(table.qd_rad_s)), robot, EXACT)


def rest_table(clean_q, label, load, band=2.0):
    """Rest poses of both sides: pinocchio's gravity and a friction band."""
    tau = torque_of(model_of(load), clean_q)
    rng = np.random.default_rng(2)
    count = len(clean_q)
    sides = []
    for side in (1, -1):
        noise = 0.3 * rng.normal(size=tau.shape)
        sides.append(
            make_table(
                [label] * count, np.arange(count), clean_q, tau + side * (band + LOSS * np.abs(tau)) + noise,
                direction=np.full((count, 6), side), run=[f"rest {label}"] * count,
            )
        )  # fmt: skip
    return concatenate(sides)


@pytest.mark.slow
def test_rest_and_moving_rows_make_one_solution(clean, robot, poses):
    moving = table_of_periods(clean, 1.0)
    rest = concatenate([rest_table(poses, "none", False), rest_table(poses, "tool", True)])
    options = Knowledge(link_std=0.05, gain_std=(0.0,) * 6)
    both, moved, still = (run(table, robot, options) for table in (concatenate([rest, moving]), moving, rest))
    load = both.loads[0]
    assert both.method == "joint"
    assert not any("left out" in finding.what for finding in both.findings)
    assert load.mass_kg == pytest.approx(MASS, abs=3 * load.mass_std_kg)
    assert (np.abs(np.array(load.inertia_kg_m2) - SIX) < 3.5 * np.array(load.inertia_std_kg_m2)).all()
    least = min(moved.loads[0].mass_std_kg, still.loads[0].mass_std_kg)
    assert load.mass_std_kg < 1.02 * least
    assert (np.array(load.com_std_m) < 1.02 * np.array(still.loads[0].com_std_m)).all()
    assert still.loads[0].inertia_kg_m2 is None
    assert still.loads[0].unidentifiable == ("inertia_kg_m2",)
    assert np.isfinite(both.friction_band_nm).all()
    assert len(both.motion) == 6
    assert max(both.rows.pose) >= 0
    assert np.nanmax(np.abs(np.array(both.rows.tau_nm) - both.rows.model_nm)) < 3.0
