"""What a further pose would add: against the information of all rows, summed and inverted."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.acquire.until_goal import LEAST_POSES, LEAST_SAMPLES, MOST_POSES, Narrowness, best_first, ended, judge
from gateway.data.table import concatenate
from gateway.estimate.expected_information import PoseNoise, Sought, information_of_priors, take_stock
from gateway.identify.knowledge import Knowledge
from gateway.identify.outliers import without_outliers
from gateway.model.regressor import gravity_regressor
from gateway.model.visits import pair_visits
from tests.data.resting_arm import Bench

GOAL = np.array([1.0, 0.01, 0.01, 0.01])
PERIOD_S, MOST_SAMPLES = 0.01, 100


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(3, [])


@pytest.fixture(scope="module")
def options(bench) -> Knowledge:
    efficiency = tuple(bench.arm.efficiency.tolist())
    return Knowledge(link_std=0.05, gain_std=(0.02,) * 6, efficiency=efficiency)


def stock_of(bench, options, table):
    visits, _ = without_outliers(pair_visits(table, options.efficiency), bench.robot, options.gravity_m_s2)
    guess = np.array([30.0, 0.0, 0.0, 0.0])
    return take_stock(visits, bench.robot, options, Sought("tool", guess, np.nanmedian(table.tau_std_nm, axis=0)))


@pytest.fixture(scope="module")
def stock(bench, options):
    return stock_of(bench, options, bench.both())


@pytest.fixture(scope="module")
def postures(bench) -> np.ndarray:
    chain = bench.arm.chain
    return np.random.default_rng(1).uniform(0.9 * chain.lower_rad, 0.9 * chain.upper_rad, (30, 6))


@pytest.fixture(scope="module")
def regressor(bench, postures) -> np.ndarray:
    return gravity_regressor(bench.robot, postures)


def turned(known):
    """Derivatives of mass and centre of gravity by the load's four unknowns."""
    mass, moment = known.moment[0], known.moment[1:]
    turn = np.zeros((4, 4))
    turn[0, 0], turn[1:, 0], turn[1:, 1:] = 1.0, -moment / mass**2, np.eye(3) / mass
    return turn


def test_a_pose_adds_the_information_of_its_rows(stock, regressor):
    known = stock.information
    variance = known.noise.friction_nm2 + known.noise.sample_nm2 / 40.0
    rows = known.rows(regressor)
    own = slice(known.load, known.load + 4)
    expected = []
    for row in rows:
        information = np.linalg.inv(known.covariance) + row.T @ np.diag(1.0 / variance) @ row
        spread = turned(known) @ np.linalg.inv(information)[own, own] @ turned(known).T
        expected.append(np.sqrt(np.diag(spread)))
    assert known.std_after(regressor, 20) == pytest.approx(np.array(expected), rel=1e-4)
    assert known.with_poses(regressor[4], 20, 1).std == pytest.approx(expected[4], rel=1e-4)


def test_what_is_promised_comes_true(bench, options, stock, postures, regressor):
    """The predicted standard deviation against that of an estimate with the pose really measured."""
    before = stock.information
    row = int(np.argmin(before.std_after(regressor, 100)[:, 0]))
    far = Bench(3, [])
    table, more = far.both(), far.more(postures[row][None])
    after = stock_of(far, options, concatenate([table, more]))
    assert after.information.std == pytest.approx(before.std_after(regressor[row][None], 100)[0], rel=0.15)
    assert (after.information.std < before.std).all()


def test_what_is_known_of_the_gains_narrows_by_the_conditional_covariance(stock):
    known = stock.information
    own, gains = np.arange(known.load, known.load + 4), known.gain
    joint = known.covariance
    spread = (
        joint[np.ix_(own, own)]
        - joint[np.ix_(own, gains)] @ np.linalg.inv(joint[np.ix_(gains, gains)]) @ joint[np.ix_(gains, own)]
    )
    assert known.std_given(gains) == pytest.approx(np.sqrt(np.diag(turned(known) @ spread @ turned(known).T)))
    assert known.std_given(gains)[0] < 0.8 * known.std[0]


def test_samples_are_the_most_informative_per_second(stock, regressor):
    """Where friction hides all, the least; where the reading's own noise does, more, up to those of the cell."""
    verdict = Narrowness(1.96 * stock.information.std, 0.1 * GOAL, np.zeros(4), 5, 5)
    seconds = np.full(len(regressor), 5.0)
    found = []
    for friction, sample in ((1.0, 1e-6), (1e-4, 1.0), (1e-6, 1e3)):
        noise = PoseNoise(np.full(6, friction), np.full(6, sample))
        known = replace(stock.information, noise=noise)
        found.append(best_first(known, verdict, regressor, seconds, PERIOD_S, MOST_SAMPLES)[1])
    assert found[0] == LEAST_SAMPLES
    assert found[2] == MOST_SAMPLES
    assert found == sorted(found)


def test_before_the_first_pose_the_load_is_open_and_two_postures_close_it(bench, options, regressor):
    noise = PoseNoise(np.full(6, 1.0), np.zeros(6))
    guess = np.array([30.0, 0.0, 0.0, 0.0])
    exact = replace(options, link_std=0.0, gain_std=(0.0,) * 6)
    known = information_of_priors(bench.robot, exact, guess, np.full(6, 10.0), noise)
    one = known.with_poses(regressor[0], 100, 1)
    two = one.with_poses(regressor[1], 100, 1)
    assert known.std[0] == pytest.approx(90.0)
    assert one.std[1:].max() > 0.1
    assert two.std[1:].max() < 0.1


def test_nothing_is_well_known_before_the_least_number_of_poses(stock, regressor):
    half = np.zeros(4)
    assert not judge(stock.information, half, GOAL, LEAST_POSES - 1, regressor, MOST_SAMPLES).done
    assert judge(stock.information, half, GOAL, LEAST_POSES, regressor, MOST_SAMPLES).done


def test_a_goal_that_the_torque_constants_hide_is_given_up_and_named(stock, regressor):
    half = 1.96 * stock.information.std
    goal = np.array([0.2 * half[0], np.inf, np.inf, np.inf])
    verdict = judge(stock.information, half, goal, 10, regressor, MOST_SAMPLES)
    assert verdict.hopeless.tolist() == [True, False, False, False]
    assert goal[0] < verdict.limit[0] < half[0]
    assert verdict.done
    said = ended(stock, verdict, "tool")
    assert "no further pose brings load tool to mass" in said
    assert "better torque constants" in said
    assert "known mass" in said
    reachable = np.array([1.05 * verdict.limit[0], np.inf, np.inf, np.inf])
    going = judge(stock.information, half, reachable, 10, regressor, MOST_SAMPLES)
    assert not going.done
    assert not going.hopeless.any()
    assert 0 < going.ahead <= MOST_POSES - 10


def test_of_two_equally_informative_poses_the_nearer_one_is_measured(stock, regressor):
    same = np.repeat(regressor[:1], 3, axis=0)
    verdict = Narrowness(1.96 * stock.information.std, 0.1 * GOAL, np.zeros(4), 5, 5)
    rows, samples = best_first(stock.information, verdict, same, np.array([6.0, 4.0, np.inf]), PERIOD_S, MOST_SAMPLES)
    assert rows.tolist() == [1, 0]
    assert LEAST_SAMPLES <= samples <= MOST_SAMPLES
