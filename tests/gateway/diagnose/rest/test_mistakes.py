"""Which commissioning mistakes are looked for, and what undoing one does to a table."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.diagnose import diagnose
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.rest_mistakes import (
    Mistake,
    band_signs,
    beyond_any_effect,
    candidates,
    determined_bands,
    find_mistakes,
    held_ratio,
)
from gateway.diagnose.rest.rest_outcome import factor_rival
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.linear import Noise
from gateway.identify.rest.start_noise import first_noise
from gateway.identify.solve import ByGroup
from gateway.model.effects import LIBRARY, MISTAKES
from gateway.model.effects.torque_constant_scale import TorqueConstantScale
from gateway.model.effects.torque_offset import TorqueOffset
from tests.data.resting_arm import Bench, basis_of, effect, found, problem_of, problems, single_joint_sweep, undirected
from tests.support.rigs.tables import make_table


def table():
    rng = np.random.default_rng(0)
    return make_table(
        ["none"] * 4, np.arange(4), rng.normal(size=(4, 6)), rng.normal(size=(4, 6)), std=0.1, direction=1
    )


@pytest.mark.parametrize("axes", [1, 2, 6])
def test_every_mistake_of_the_measured_axes_is_looked_for_once(axes):
    found = list(candidates(np.arange(6) < axes))
    pairs = axes * (axes - 1) // 2
    counts = {name: len([each for each in found if each.name == name]) for name in {each.name for each in found}}
    # a factor on one axis or, where there are several, on all; swapped torque alone, or with the angles; coupled
    # angles of neighbours, added or subtracted
    expected = {
        "sign_reversed": axes,
        "joint_reversed": axes,
        "axes_swapped": 2 * pairs,
        "angles_coupled": 2 * (axes - 1),
        "zero_convention": 3 * axes,
        "current_rms_peak": 2 * (axes + (axes > 1)),
    }
    assert counts == {name: count for name, count in expected.items() if count}
    assert len(set(found)) == len(found)
    assert {joint for each in found for joint in each.joints} == set(range(1, axes + 1))
    assert {each.handicap > 0 for each in found if len(each.joints) > 2} <= {True}


@pytest.mark.parametrize(
    ("joints", "log_odds", "name"),
    [
        ((2,), -1.0, "current_rms_peak"),  # the constant is likelier
        ((2,), 1.0, "torque_constant_scale"),
        ((2,), 4.0, None),  # the data decide
        ((3,), 1.0, None),  # another axis
    ],
)
def test_a_factor_and_a_wrong_constant_of_one_axis_are_rivals(joints, log_odds, name):
    factor = Mistake("current_rms_peak", joints, float(np.sqrt(2.0)))
    read = SimpleNamespace(terms=(TorqueConstantScale(1), TorqueOffset(2)))
    rival = factor_rival([factor], read, log_odds)
    assert (rival and rival.name) == name
    if rival is not None:
        assert rival.joints == joints
        assert rival.evidence.odds == pytest.approx(np.exp(-abs(log_odds)))
        assert next(iter(rival.parameters.values())) == pytest.approx(2.0 ** (0.5 if log_odds < 0.0 else -0.5))


def test_undoing_a_mistake_touches_its_axes_alone():
    read = table()
    turned = Mistake("sign_reversed", (3,)).undo(read)
    assert turned.tau_nm == pytest.approx(read.tau_nm * [1, 1, -1, 1, 1, 1])
    assert turned.tau_std_nm == pytest.approx(read.tau_std_nm)
    counted = Mistake("joint_reversed", (3,)).undo(read)
    for name in ("tau_nm", "q_rad", "direction"):
        assert getattr(counted, name) == pytest.approx(getattr(read, name) * [1, 1, -1, 1, 1, 1])
    assert counted.direction.dtype == read.direction.dtype
    apart = Mistake("angles_coupled", (2, 3), sign=-1.0).undo(read)
    assert apart.q_rad[:, 2] == pytest.approx(read.q_rad[:, 2] + read.q_rad[:, 1])
    assert apart.tau_nm is read.tau_nm
    quarter = Mistake("zero_convention", (4,), offset_rad=np.pi / 2).undo(read)
    assert quarter.q_rad == pytest.approx(read.q_rad + np.pi / 2 * np.array([0, 0, 0, 1, 0, 0]))
    assert quarter.tau_nm is read.tau_nm
    halved = Mistake("current_rms_peak", (2, 5), 2.0).undo(read)
    assert halved.tau_nm == pytest.approx(read.tau_nm * [1, 0.5, 1, 1, 0.5, 1])
    assert halved.tau_std_nm == pytest.approx(read.tau_std_nm * [1, 0.5, 1, 1, 0.5, 1])
    for with_positions in (False, True):
        swapped = Mistake("axes_swapped", (1, 4), with_positions=with_positions).undo(read)
        order = [3, 1, 2, 0, 4, 5]
        assert swapped.tau_nm == pytest.approx(read.tau_nm[:, order])
        assert swapped.q_rad == pytest.approx(read.q_rad[:, order] if with_positions else read.q_rad)


def test_an_outlier_stays_rejected_on_its_drive_when_cables_are_exchanged():
    """Its visit is not measured on the axis that the drive turns out to move."""
    bench = Bench(8, [effect("axes_swapped", [2, 3])])
    read = bench.both()
    torques = np.zeros((len(read), 6), dtype=bool)
    torques[8, 1] = torques[14, 4] = True  # the first approaches of visits 4 and 7
    swapped = Mistake("axes_swapped", (2, 3), with_positions=True)
    problem = RestDiagnosis(bench.robot, bench.options).problem(read, torques, (swapped,))
    assert np.argwhere(~problem.use_sum).tolist() == [[4, 2], [7, 4]]


HEALTHY = [
    (2, 2, []),
    (2, 2, [effect("torque_offset", [1], offset_nm=30.0)]),
    (3, 3, [effect("balancer_spring", [2], stiffness_n_m=2e4, lever_m=0.2, anchor_m=0.5, free_length_m=0.2)]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "axis", "hidden"), HEALTHY)
def test_a_table_in_which_one_axis_moves_shows_no_mistake(seed, axis, hidden):
    bench = Bench(seed, hidden)
    read = undirected(single_joint_sweep(bench, axis))
    result = diagnose(read, bench.robot, bench.options)
    assert not result.failed
    assert not {name for name, _ in found(result)} & set(MISTAKES)
    # even where one is looked for
    build = problems(bench, read)
    assert find_mistakes(build, frozenset(LIBRARY)) == ((), 0.0)


@pytest.mark.slow
def test_nor_does_a_table_of_which_one_axis_was_measured():
    bench = Bench(8, [effect("sign_reversed", [3])])
    read = bench.both()
    assert [each.joints for each in find_mistakes(problems(bench, read), frozenset(LIBRARY))[0]] == [(3,)]
    alone = replace(read, tau_nm=np.where(np.arange(6) == 2, read.tau_nm, np.nan))
    assert find_mistakes(problems(bench, alone), frozenset(LIBRARY))[0] == ()


def rows_of(side, two_sided, measured=True):
    """What is known of the sides of visits (n, N)."""
    side, both = np.asarray(side, dtype=float), np.asarray(two_sided, dtype=bool)
    use = np.full(side.shape, measured)
    return SimpleNamespace(use_sum=use, use_difference=use & both, rows=SimpleNamespace(side=side))


def test_a_band_is_determined_by_visits_from_both_sides():
    none, two = np.zeros((4, 1)), np.ones((4, 1))
    assert determined_bands(rows_of(none, two))[0]
    assert not determined_bands(rows_of(none, none))[0]  # no direction was written down
    assert not determined_bands(rows_of(two, none))[0]  # all from below: an offset looks the same
    assert determined_bands(rows_of([[1.0], [-1.0], [1.0], [-1.0]], none))[0]
    assert not determined_bands(rows_of([[1.0], [-1.0], [0.0], [0.0]], none))[0]
    assert not determined_bands(rows_of([[1.0], [0.0], [0.0], [1.0]], none))[0]
    assert not determined_bands(rows_of(none, two, measured=False))[0]


@pytest.mark.parametrize("sides", ["none", "from below"])
def test_the_sign_of_a_band_that_nothing_determines_says_nothing(sides):
    """A motor that reads 40 Nm too little, from one side alone, looks like friction that gives power."""
    bench = Bench(3, [effect("torque_offset", [axis], offset_nm=-40.0) for axis in (1, 2, 3)])
    read = bench.both()
    read = undirected(read) if sides == "none" else read.take(read.direction[:, 0] > 0)
    problem = problem_of(bench, read)
    plain = fit(problem, (), first_noise(problem))
    assert band_signs(problem, plain) == 0.0
    wrong = replace(plain, band=np.full(6, -1e3))
    assert band_signs(problem, wrong) == 0.0
    complete = problem_of(bench, bench.both())
    assert band_signs(complete, replace(fit(complete, (), first_noise(complete)), band=np.full(6, -1e3))) < -1e3
    assert beyond_any_effect(complete, replace(fit(complete, (), first_noise(complete)), band=np.full(6, -1e3)))


def judged(residual, band, std=2.0, poses=5):
    """A fit of nothing to half differences of one axis, one a pose."""
    rows = SimpleNamespace(pose=np.arange(poses), side=np.zeros((poses, 1)))
    problem = SimpleNamespace(
        rows=rows,
        visit=np.arange(poses),
        use_sum=np.ones((poses, 1), dtype=bool),
        use_difference=np.ones((poses, 1), dtype=bool),
        group=np.ones(poses, dtype=int),
        band_part=slice(0, 1),
        place=np.arange(poses),
    )
    fitted = SimpleNamespace(
        noise=Noise(np.array([1.0, std]), np.array([1.0, std]), np.zeros(2)),
        residual=np.asarray(residual, dtype=float),
        basis=basis_of(np.zeros((poses, 0))),
        columns=ByGroup.of(np.ones((poses, 1))),
        scale=np.ones(1),
        band=np.array([float(band)]),
    )
    return problem, fitted


def test_a_mistake_is_judged_on_left_out_poses_with_its_uncertainty():
    before, after = np.array([4.0, 6.0, 5.0, 3.0, 7.0]), np.array([2.0, 1.0, 3.0, 2.5, 1.5])
    ratio, upper = held_ratio(*judged(before, 1.0), *judged(after, 1.0))
    assert ratio == pytest.approx(np.sqrt((after**2).sum() / (before**2).sum()))
    # of all draws of five poses with replacement, each as likely
    drawn = np.array(list(itertools.product(range(5), repeat=5)))
    ratios = np.sqrt((after**2)[drawn].sum(axis=1) / (before**2)[drawn].sum(axis=1))
    assert upper == pytest.approx(np.quantile(ratios, 0.95), rel=0.03)
    # each in units of its own floor: a reading that is twice as large is not twice as bad
    assert held_ratio(*judged(before, 1.0), *judged(2.0 * before, 1.0, std=4.0))[0] == pytest.approx(1.0)
    worse = held_ratio(*judged(after, 1.0), *judged(before, 1.0))
    assert min(worse) > 1.0


def test_friction_that_gives_power_foretells_nothing():
    """The same residuals, but of a band below zero, which has to be left out: the rows are as large as the band."""
    left = np.array([0.1, -0.1, 0.2, -0.2, 0.1])
    ratio, upper = held_ratio(*judged(left, -3.0), *judged(-left, 3.0))
    assert ratio == pytest.approx(np.sqrt((left**2).sum() / ((left - 3.0) ** 2).sum()))
    assert upper < 1.0
    assert held_ratio(*judged(left, 3.0), *judged(-left, 3.0))[0] == pytest.approx(1.0)


@pytest.mark.slow
def test_a_mistake_that_unseen_rows_contradict_is_taken_back():
    """Drives that were swapped for the first run alone: the rows held out were read as they should be."""
    bench, healthy = Bench(8, [effect("sign_reversed", [3])]), Bench(8, [])
    read = bench.both()
    fresh = healthy.both()
    fresh = replace(fresh, pose=fresh.pose + 50)
    only = frozenset({"sign_reversed", "base_tilt"})
    assert found(diagnose(read, bench.robot, bench.options, only=only)) == [("sign_reversed", (3,))]
    result = diagnose(read, bench.robot, bench.options, holdout=fresh, only=only)
    assert "sign_reversed" not in {name for name, _ in found(result)}
    assert result.verdict in ("unexplained", "improved")
    again = replace(bench.both(), pose=read.pose + 50)
    same = diagnose(read, bench.robot, bench.options, holdout=again, only=only)
    assert ("sign_reversed", (3,)) in found(same)
    entry = next(entry for entry in same.effects if entry.name == "sign_reversed")
    assert 0.0 < entry.evidence.holdout_rms_ratio < 1.0
