"""Readings that change from one recording to the next, and visits that repeat a pose; torque by pinocchio."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.data.rows import Table, concatenate
from gateway.estimate import estimate
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf
from tests.data.arms import carrying, peer_of, sines, torque_of
from tests.data.moving_arm import as_period
from tests.support.rigs.tables import make_table

TEXT = (Path(__file__).parents[3] / "examples" / "small" / "robot.urdf").read_text(encoding="utf-8")
ROBOT = robot_from_urdf(TEXT, "small")
LOAD = (5.0, 0.05, 0.02, 0.12)
LIMIT = np.array([2.5, 1.4, 1.6, 2.5, 1.6, 2.5])
POSES = np.random.default_rng(4).uniform(-LIMIT, LIMIT, (10, 6))
BAND_NM = np.array([10.0, 8.0, 5.0, 1.0, 1.0, 0.5])
#: One standard deviation of the change of an axis and of all axes on one occasion, and a pattern of it.
CHANGE = 0.003 + 0.004 * np.array([1, -1, 1, -1, 1, 1])
PRECISE = Knowledge(link_std=np.inf, gain_std=(0.003,) * 6)


def torque_nm(load: str, q, qd=None, qdd=None) -> np.ndarray:
    """Torque [Nm] of the arm, loaded unless `load` is none."""
    model, _ = peer_of(TEXT)
    return torque_of(model if load == "none" else carrying(model, LOAD[0], LOAD[1:], 0.02 * np.eye(3)), q, qd, qdd)


def rest(load: str, run: str, gain=0.0, start_s=0.0, q=POSES, first=0, bias_nm=0.0, seed=0) -> Table:
    """Two-sided visits of one occasion; `gain` and `bias_nm` are errors of its readings."""
    rng, count = np.random.default_rng([seed, len(load), int(start_s)]), len(q)
    torque = torque_nm(load, q) + bias_nm
    sides = [torque + side * BAND_NM * (1 + 0.01 * rng.standard_normal(torque.shape)) for side in (1, -1)]
    return make_table(
        [load] * (2 * count),
        np.tile(np.arange(first, first + count), 2),
        np.tile(q, (2, 1)),
        (1 + gain) * np.vstack(sides),
        run=[run] * (2 * count),
        time=start_s + 20.0 * np.tile(np.arange(count), 2) + np.repeat([0.0, 8.0], count),
        direction=np.repeat([[1] * 6, [-1] * 6], count, axis=0),
    )


def motion(load: str, run: str, gain=0.0, start_s=0.0) -> Table:
    """Rows of one occasion in motion, 12 s of sines."""
    rng, time = np.random.default_rng([1, len(load)]), np.arange(600) * 0.02
    rate = 2 * np.pi / 12.0 * np.arange(1, 6)[:, None]
    size, phase = np.random.default_rng(3).uniform(0.1, 0.4, (5, 6)), np.arange(30).reshape(5, 6)
    q, qd, qdd = sines(time, size, rate, phase)
    noise = 0.02 * BAND_NM * rng.standard_normal(q.shape)
    tau = torque_nm(load, q, qd, qdd) + 0.3 * BAND_NM * np.tanh(qd / 0.02) + 0.2 * BAND_NM * qd + noise
    return make_table(
        [load] * len(q), np.full(len(q), -1), q, (1 + gain) * tau,
        run=[run] * len(q), time=start_s + time, qd=qd, qdd=qdd, direction=np.sign(qd),
    )  # fmt: skip


def both(load: str, run: str, gain=0.0, start_s=0.0) -> Table:
    """One recording at rest and then in motion."""
    return concatenate([rest(load, run, gain, start_s), motion(load, run, gain, start_s + 300.0)])


def periods(load: str, run: str, gain=0.0, start_s=0.0) -> Table:
    """Three periods of one excitation, as a recording has them."""
    parts, rng, one = [], np.random.default_rng([2, len(run)]), motion(load, run, gain, start_s)
    for number in range(3):
        noisy = one.tau_nm + 0.02 * BAND_NM * rng.standard_normal(one.tau_nm.shape)
        parts.append(as_period(one, noisy, 7.0, number, 12.0))
    return concatenate(parts)


def off(load) -> float:
    """Error of a mass in standard deviations."""
    return abs(load.mass_kg - LOAD[0]) / load.mass_std_kg


def occasions(found) -> int:
    """Number of occasions, each with its change of gain."""
    return len({name.split("[")[0] for name in found.names if name.startswith("change")})


@pytest.mark.parametrize("recorded", [motion, both])
@pytest.mark.parametrize("change", [CHANGE, np.full(6, 0.005)], ids=["by axis", "of all"])
def test_recordings_in_motion_may_read_differently(recorded, change):
    table = concatenate([recorded("none", "r"), recorded("tool", "r", change, 2000.0)])
    (load,) = estimate(table, ROBOT, PRECISE).loads
    assert off(load) < 2.5
    assert load.mass_std_kg < 0.02 * LOAD[0]


def test_a_recording_at_rest_and_in_periods_is_one_occasion():
    """Both read with one change of gain: taken for two occasions, they would seem to average it out."""
    still = [rest("none", "r"), rest("tool", "s", CHANGE, 2000.0)]
    moved = [periods("none", "r", start_s=300.0), periods("tool", "s", CHANGE, 2300.0)]
    apart = [replace(table, run=np.full(len(table), f"{table.run[0]} at rest")) for table in still]
    one, two = (estimate(concatenate([*tables, *moved]), ROBOT, PRECISE) for tables in (still, apart))
    assert (occasions(one), occasions(two)) == (2, 4)
    assert off(one.loads[0]) < 2.5
    assert one.loads[0].mass_std_kg > 1.05 * two.loads[0].mass_std_kg


def test_periods_are_averaged_within_a_recording():
    """Two recordings of one load read differently: each is an occasion, and none is averaged with the other."""
    tools = [periods("tool", run, sign * CHANGE, 100.0 * k) for k, (run, sign) in enumerate((("s", 1), ("t", -1)))]
    found = estimate(concatenate([periods("none", "r"), *tools]), ROBOT, PRECISE)
    assert occasions(found) == 3
    second, third = (found.value[found.names.index(f"change_{k}[J2]")] for k in (2, 3))
    assert np.sign(second - third) == np.sign(CHANGE[1])
    assert off(found.loads[0]) < 2.5


def test_three_percent_mean_the_same_in_motion_whether_stated_or_usual():
    """Half of the variance of the constants is common to all axes in both."""
    table = concatenate([motion("none", "a"), motion("tool", "b", start_s=100.0)])
    usual, stated = (estimate(table, ROBOT, replace(PRECISE, gain_std=std)).loads[0] for std in (None, (0.03,) * 6))
    assert stated.mass_std_kg == pytest.approx(usual.mass_std_kg)
    assert stated.mass_kg == pytest.approx(usual.mass_kg)


def test_the_number_of_recordings_takes_no_change_away():
    """Each load is in one recording: those of other loads say nothing of its reading."""
    found = []
    for count in (4, 8):
        tools = [rest(f"tool{k}", "r", CHANGE * (-1) ** k, 600.0 * (k + 1)) for k in range(count)]
        loads = estimate(concatenate([rest("none", "r"), *tools]), ROBOT, PRECISE).loads
        assert max(map(off, loads)) < 2.5
        found.append(loads[0].mass_std_kg)
    assert found[1] > 0.9 * found[0]


def test_four_recordings_of_one_load_are_one_body():
    signs = np.sign(np.random.default_rng(2).standard_normal((8, 6)))
    parts = [
        rest(load, f"r{k}", 1.5 * 0.004 * signs[2 * k + (load != "none")], 1200.0 * k + 600.0 * (load != "none"))
        for k in range(4)
        for load in ("none", "tool")
    ]
    (load,) = estimate(concatenate(parts), ROBOT, PRECISE).loads
    assert load.refused is None
    assert off(load) < 2.5


def test_an_occasion_is_a_run_and_a_load_and_no_text():
    """Names that are equal once joined by a stroke are two occasions, whose readings change independently."""
    found = []
    for names in ((("a/b", "c"), ("a", "b/c")), (("p", "c"), ("q", "d"))):
        tools = [rest(load[-1], run, 0.0, 600.0 * k) for k, (run, load) in enumerate(names, 1)]
        named = [replace(tool, load=np.full(len(tool), load)) for tool, (_, load) in zip(tools, names, strict=True)]
        same = [replace(tool, tau_nm=named[0].tau_nm) for tool in named]
        found.append(estimate(concatenate([rest("none", "n"), *same]), ROBOT, PRECISE).loads)
    joined, apart = (sorted(load.mass_std_kg for load in loads) for loads in found)
    assert joined == pytest.approx(apart, rel=2e-3)


def test_pose_numbers_that_a_second_run_uses_again_do_not_matter():
    def run_of(first: int) -> Table:
        halves = ((POSES[:5], 0, "r0"), (POSES[5:], first, "r1"))
        return concatenate(
            [
                rest(load, run, 0.0, 1200.0 * (first > 0) + 600.0 * (load != "none"), q, number)
                for q, number, run in halves
                for load in ("none", "tool")
            ]
        )

    again, unique = (replace(run_of(5), pose=run_of(first).pose) for first in (0, 5))
    same, expected = (estimate(table, ROBOT, PRECISE) for table in (again, unique))
    assert same.loads[0].mass_kg == pytest.approx(expected.loads[0].mass_kg)
    assert same.loads[0].mass_std_kg == pytest.approx(expected.loads[0].mass_std_kg)


def test_repeats_do_not_average_what_the_model_lacks_at_a_pose():
    """A bias of each place, far above the noise: four visits know it no better than one."""
    bias = 0.2 * BAND_NM * np.random.default_rng(6).standard_normal((2, 10, 6))
    com_std_m = []
    for visits in (1, 4):
        parts = [
            rest(load, "r", 0.0, 1500.0 * k + 300.0 * visit, bias_nm=bias[k], first=10 * visit, seed=visit)
            for k, load in enumerate(("none", "tool"))
            for visit in range(visits)
        ]
        com_std_m.append(np.array(estimate(concatenate(parts), ROBOT, PRECISE).loads[0].com_std_m))
    assert (com_std_m[1] > 0.75 * com_std_m[0])[1:].all()
    assert (com_std_m[1] < 1.3 * com_std_m[0]).all()
