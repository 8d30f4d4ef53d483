"""Force inside the part from twelve torques: sign and size, joints that friction hides, constants that are off.

Torques are made by the virtual work of two forces on numerically turned joints, not by the Jacobians under test.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.data.visit import ArmSample
from gateway.pair.balance import SAMPLE_SHARE, ForceBalance
from gateway.pair.calibration import PathWrenches
from gateway.pair.joint_targets import ExternalTorque, JointFollower, Shown
from gateway.pair.model_uncertainty import COULOMB_SHARE, DELAY_STD_S, LINK_SHARE, ModelUncertainty, constants_of
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import calibration_of

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
EXAMPLE = EXAMPLES / "pair" / "cell.toml"
TURN_RAD = 1e-6


class Bench:
    """Both arms along their path, moving freely but for what a test puts between the hands."""

    def __init__(self, cell_file: Path = EXAMPLE) -> None:
        self.cell = cell = load_pair(cell_file)
        self.path = path = cell.path(1.5)
        slave = cell.nominal_slave(path)
        followers = [JointFollower(arm, q) for arm, q in zip(cell.arms, cell.joints(path), strict=True)]
        lag_s = cell.config.servo_lag_s
        first, second = (ExternalTorque(arm, f, path.dt_s, lag_s) for arm, f in zip(cell.arms, followers, strict=True))
        self.arms = (first, second)
        self.maps = PathWrenches(calibration_of(cell), path, slave)
        self.balance = ForceBalance(self.arms, self.maps, path.dt_s, cell.config.force_filter_hz)
        self.q = [each.q_rad for each in self.arms]
        self.free = []
        for arm, q in zip(cell.arms, self.q, strict=True):
            speed = np.zeros_like(q)
            speed[1:-1] = (q[2:] - q[:-2]) / (2 * path.dt_s)
            change = np.zeros_like(q)
            change[1:-1] = (q[2:] - 2 * q[1:-1] + q[:-2]) / path.dt_s**2
            rubbing = arm.coulomb_nm * np.sign(speed) + arm.viscous_nm_s_rad * speed
            self.free.append(arm.model_torque(q, speed, change) + rubbing)
        self.speed = [np.gradient(q, path.dt_s, axis=0) for q in self.q]
        self.share_nm = [self.hands_nm(arm) for arm in (0, 1)]

    def tips(self, arm: int, turned_rad: np.ndarray) -> np.ndarray:
        """Fingertips (M, 4, 4) of an arm in the world, its joints turned by (N,)."""
        chosen = self.cell.arms[arm]
        return chosen.world_from_base @ chosen.chain.poses(self.q[arm] + turned_rad)[0]

    def virtual_work_nm(self, arm: int, force_n: np.ndarray, moment_nm: np.ndarray) -> np.ndarray:
        """Torque (M, N) that holds a force and a moment (M, 3), world axes, at the fingertip of an arm."""
        out = np.empty_like(self.q[arm])
        for joint, unit in enumerate(np.eye(self.cell.arms[arm].axes)):
            ahead, behind = (self.tips(arm, side * TURN_RAD * unit) for side in (1, -1))
            move = (ahead - behind)[:, :3, 3] / (2 * TURN_RAD)
            turn = Rotation.from_matrix(ahead[:, :3, :3] @ np.swapaxes(behind[:, :3, :3], 1, 2)).as_rotvec()
            work = np.sum(move * force_n, axis=1) + np.sum(turn * moment_nm, axis=1) / (2 * TURN_RAD)
            out[:, joint] = -work
        return out

    def centre(self) -> np.ndarray:
        """Middle of the part (M, 3) where the arms are, by the master's hand."""
        return (self.tips(0, np.zeros(1)) @ np.linalg.inv(self.cell.arms[0].part_from_tip))[:, :3, 3]

    def part_n(self) -> np.ndarray:
        """Half the part's weight and inertia (M, 3)."""
        centre = self.centre()
        change = np.gradient(np.gradient(centre, self.path.dt_s, axis=0), self.path.dt_s, axis=0)
        return 0.5 * self.cell.config.part_mass_kg * (np.array([0.0, 0.0, -9.80665]) - change)

    def hands_nm(self, arm: int, force_n=(0.0, 0.0, 0.0)) -> np.ndarray:
        """Torque (M, N) of an arm for its share of the part and a force inside it, on gripper 2 as it is."""
        inside = (-1.0, 1.0)[arm] * np.broadcast_to(force_n, (len(self.path), 3))
        lever_m = self.centre() - self.tips(arm, np.zeros(1))[:, :3, 3]
        return self.virtual_work_nm(arm, self.part_n() + inside, np.cross(lever_m, inside))

    def held_nm(self, force_n: tuple[float, float, float]) -> np.ndarray:
        """Torque of all joints for a force inside the part alone, at the start of the path."""
        return np.concatenate([(self.hands_nm(arm, force_n) - self.share_nm[arm])[0] for arm in (0, 1)])

    def run(
        self, force_n: np.ndarray, extra_nm=(0.0, 0.0), uncertainty: ModelUncertainty | None = None, off_s=0.0
    ) -> ModelUncertainty:
        """A path with a force (M, 3) inside the part, on gripper 2 as it is, and torques (M, N) beside.

        Both grippers feel it about the part's middle, so that the part has no cause to turn. Positions are those of
        instants (M, 1) that are `off_s` beside what is reported of them.
        """
        joints = sum(arm.axes for arm in self.cell.arms)
        uncertainty = uncertainty or ModelUncertainty(constants_of(joints))
        torque = [self.free[arm] + self.hands_nm(arm, force_n) + extra_nm[arm] for arm in (0, 1)]
        shown = [q + off_s * speed for q, speed in zip(self.q, self.speed, strict=True)]
        self.balance.begin(uncertainty)
        for m in range(len(self.path)):
            time_s = m * self.path.dt_s
            seen = [
                arm.update(m, ArmSample(m, time_s, q[m], nm[m], (object(),) * len(q[m])))  # type: ignore[arg-type]
                for arm, q, nm in zip(self.arms, shown, torque, strict=True)
            ]
            self.balance.take(m, (seen[0], seen[1]), m - 1 if m else None)
        return uncertainty

    def learn_from(self, force_n: np.ndarray, *others, **named) -> ModelUncertainty:
        """A path as that of `run`, from which the constants are learned."""
        uncertainty = self.run(force_n, *others, **named)
        self.balance.learn()
        return uncertainty

    def turns(self, arm: int, joint: int) -> np.ndarray:
        """Direction (M,) in which a joint turns."""
        return np.sign(self.speed[arm][:, joint])


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.fixture(scope="module")
def thirteen() -> Bench:
    """An arm of seven axes and one of six."""
    return Bench(EXAMPLES / "pair-unequal" / "seven-six.toml")


def pulled(bench: Bench, force_n: tuple[float, float, float]) -> np.ndarray:
    return np.tile(force_n, (len(bench.path), 1))


@pytest.mark.parametrize(("which", "joints"), [("bench", 12), ("thirteen", 13)])
@pytest.mark.parametrize("force_n", [(30.0, 0.0, 0.0), (0.0, -20.0, 10.0)])
def test_a_force_inside_the_part_is_found_with_its_sign_and_its_weight_is_none(which, joints, force_n, request):
    """By virtual work of both hands; further rows determine 5 constants a joint and 4 of the part."""
    bench = request.getfixturevalue(which)
    uncertainty = bench.learn_from(pulled(bench, force_n))
    assert uncertainty.value.shape == (5 * joints + 4,)
    found = bench.balance.internal_force()
    wrong = np.linalg.norm(found.wrench[50:-50, :3] - force_n, axis=1)
    assert np.sqrt(np.mean(wrong**2)) < 2.5
    assert wrong.max() < 6.0
    assert bench.balance.wrench[:3] == pytest.approx(force_n, abs=6.0)


@pytest.mark.parametrize("joint", [2, 10])
def test_what_the_friction_of_a_joint_at_rest_may_feign_fades_once_all_joints_turn(bench, joint):
    """It fades to the smallest numbers there are, whose rounding does not keep a variance positive."""
    rng, turned = np.random.default_rng(11), np.ones(12)
    turned[joint] = 0.0
    bench.balance.begin(ModelUncertainty(constants_of(12)))
    for _ in range(2600):
        torque = 30.0 * rng.normal(size=12)
        seen = [Shown(torque[arm], turned[arm], turned[arm], np.zeros(6)) for arm in (slice(0, 6), slice(6, 12))]
        bench.balance.take(1, (seen[0], seen[1]), None)
        assert np.isfinite(bench.balance.inputs(1)).all()
        turned = np.ones(12)


def test_friction_of_the_additional_axis_is_estimated_too(thirteen):
    """Joint 3 of the arm of seven has a quarter less friction than the cell says; its neighbours do not."""
    extra = np.zeros((len(thirteen.path), 7))
    extra[:, 2] = -0.25 * thirteen.cell.arms[0].coulomb_nm[2] * thirteen.turns(0, 2)
    uncertainty = thirteen.learn_from(pulled(thirteen, (0.0, 0.0, 0.0)), (extra, 0.0))
    assert uncertainty.value[2] == pytest.approx(-0.25 / COULOMB_SHARE, abs=0.35)
    assert np.abs(uncertainty.value[[0, 1, 3, 4, 5, 6, 7, 8]]).max() < 0.35


def test_links_and_delays_of_an_arm_ask_for_torque_of_its_own_joints_alone(thirteen):
    """Seven links and seven delays of the master, six and six of the slave, then the part."""
    along, row = thirteen.balance.columns.along, 700
    assert along.shape[1:] == (13, 2 * 13 + 4)
    for arm, own, first in ((thirteen.arms[0], slice(0, 7), 0), (thirteen.arms[1], slice(7, 13), 14)):
        motion = (arm.q_rad, arm.speed_rad_s, arm.acceleration_rad_s2)
        axes = arm.arm.axes
        columns = along[row][:, first : first + 2 * axes]
        assert not np.delete(columns, np.arange(own.start, own.stop), axis=0).any()
        links = np.stack([each[row] for each in arm.arm.link_torques(*motion)], axis=1)
        assert columns[own, :axes] == pytest.approx(LINK_SHARE * links)
        before, after = (arm.arm.model_torque(*(each[at][None] for each in motion))[0] for at in (row - 1, row + 1))
        delayed_nm = DELAY_STD_S * (after - before) / (2 * thirteen.path.dt_s)
        assert columns[own, axes:] == pytest.approx(np.diag(delayed_nm))


@pytest.mark.parametrize("which", ["bench", "thirteen"])
def test_the_torque_of_constants_is_that_of_their_columns(which, request):
    bench = request.getfixturevalue(which)
    balance, joints = bench.balance, sum(arm.axes for arm in bench.cell.arms)
    random = np.random.default_rng(8)
    motion = random.standard_normal((3, balance.count, joints))
    by = random.standard_normal(constants_of(joints))
    for row in (0, 500):
        torque_nm = balance.columns.torque(row, by, *(each[row] for each in motion))
        assert torque_nm == pytest.approx(balance.columns.of(*motion)[row] @ by)


def test_each_hand_alone_receives_the_force_inside_the_part(bench):
    """All of the force, where every joint turns and friction hides nothing."""
    held_force(bench, bench.held_nm((30.0, 0.0, 0.0)), 1.0)
    one, two = bench.balance.inputs(0)
    for alone in ((one, None), (None, two)):
        assert bench.maps.internal(0, *alone)[:3] == pytest.approx((30.0, 0.0, 0.0), abs=1.0)


def test_a_change_of_friction_is_estimated_from_the_shared_part(bench):
    """Joint 2 of the master has a quarter more friction than the cell says: 6.75 Nm."""
    extra = np.zeros((len(bench.path), 6))
    extra[:, 1] = 0.25 * bench.cell.arms[0].coulomb_nm[1] * bench.turns(0, 1)
    uncertainty = bench.run(pulled(bench, (0.0, 0.0, 0.0)), (extra, 0.0))
    before = np.abs(bench.balance.internal_force().wrench[50:-50, :3]).max()
    bench.balance.learn()
    after = np.abs(bench.balance.internal_force().wrench[50:-50, :3]).max()
    assert uncertainty.value[1] == pytest.approx(0.25 / COULOMB_SHARE, abs=0.35)
    assert np.sqrt(uncertainty.covariance[1, 1]) < 0.4
    assert after < 0.6 * before


def test_wrong_instants_determine_no_inertia(bench):
    """30 us at 4 ms feign accelerations above the true ones: torques without a cause would be attributed to rotors."""
    off_s = np.random.default_rng(1).normal(0.0, 30e-6, (len(bench.path), 1))
    uncertainty = bench.learn_from(np.zeros((len(bench.path), 3)), off_s=off_s)
    assert np.abs(uncertainty.value).max() < 1.5
    assert np.linalg.norm(bench.balance.internal_force().wrench[:, :3], axis=1).max() < 30.0


@pytest.mark.slow
def test_a_cable_force_in_one_direction_changes_no_constants_of_the_arms(bench):
    """20 N at the slave's hand, across the bar: once they are a passing snag, twice in a row they are there to stay."""
    free = pulled(bench, (0.0, 0.0, 0.0))
    uncertainty = ModelUncertainty(constants_of(12))
    for _ in range(3):
        bench.learn_from(free, uncertainty=uncertainty)
        assert not bench.balance.internal_force().pulled
    cable = bench.virtual_work_nm(1, pulled(bench, (0.0, 20.0, 0.0)), free)
    before = uncertainty.value.copy()
    bench.learn_from(free, (0.0, cable), uncertainty)
    assert bench.balance.internal_force().pulled
    assert np.array_equal(uncertainty.value, before)
    bench.learn_from(free, (0.0, cable), uncertainty)
    assert not bench.balance.internal_force().pulled
    assert np.abs(uncertainty.value - before).max() > 0.3
    bench.learn_from(free, uncertainty=uncertainty)
    bench.learn_from(free, uncertainty=uncertainty)
    assert not bench.balance.internal_force().pulled


def test_friction_of_another_day_is_no_cable(bench):
    """All joints have a quarter more, or less, friction than the cell says: estimated at once."""
    for share in (0.25, -0.25):
        extra = [
            share * arm.coulomb_nm * np.stack([bench.turns(a, joint) for joint in range(6)], axis=1)
            for a, arm in enumerate(bench.cell.arms)
        ]
        bench.learn_from(pulled(bench, (0.0, 0.0, 0.0)), (extra[0], extra[1]))
        assert not bench.balance.internal_force().pulled


def test_a_joint_that_has_not_turned_yet_has_little_weight(bench):
    """15 Nm, all of the friction of the slave's joint 3: force where the joint turns, friction where that is open."""
    row = len(bench.path) // 2
    extra = np.zeros((2, 6))
    extra[1, 2] = bench.cell.arms[1].coulomb_nm[2]
    estimated_n, std_n = [], []
    for settled in (1.0, 0.0):
        turned = np.ones((2, 6))
        turned[1, 2] = settled
        bench.balance.begin(ModelUncertainty(constants_of(12)))
        one, two = (
            Shown(bench.share_nm[arm][row] + extra[arm], turned[arm], np.zeros(6), np.zeros(6)) for arm in (0, 1)
        )
        bench.balance.take(row + 1, (one, two), None)
        estimated_n.append(np.linalg.norm(bench.balance.wrench[:3]))
        std_n.append(np.sqrt(np.trace(bench.balance.covariance[:3, :3])))
    assert estimated_n[1] < 0.7 * estimated_n[0]
    assert std_n[1] > std_n[0]


def held_force(bench: Bench, extra_nm: np.ndarray, turned: float) -> np.ndarray:
    """Estimated force (3,) after twelve SYNCs at the start, with torques (12,) besides those of the part."""
    seen = [
        Shown(bench.share_nm[arm][0] + extra_nm[6 * arm :][:6], np.full(6, turned), np.zeros(6), np.zeros(6))
        for arm in (0, 1)
    ]
    bench.balance.begin(ModelUncertainty(constants_of(12)))
    for _ in range(12):
        bench.balance.take(0, (seen[0], seen[1]), None)
    return bench.maps.internal(0, *bench.balance.inputs(0))[:3]


def test_hands_do_not_yield_to_what_friction_at_rest_may_be(bench):
    """Half of each joint's friction, to either side, feigns 10 N and more; the same torques count once joints turn."""
    random = np.random.default_rng(5)
    coulomb_nm = np.concatenate([arm.coulomb_nm for arm in bench.cell.arms])
    draws = [0.5 * coulomb_nm * random.choice([-1.0, 1.0], 12) for _ in range(20)]
    feigned = []
    for extra in draws:
        yielded = np.linalg.norm(held_force(bench, extra, 0.0))
        feigned.append(np.linalg.norm(bench.balance.wrench[:3]))
        assert yielded <= 0.5 * feigned[-1]
    assert np.median(feigned) > 10.0
    turning = [np.linalg.norm(held_force(bench, extra, 1.0)) for extra in draws]
    assert np.median(turning) > 10.0


def test_hands_yield_to_a_force_at_rest_that_no_friction_explains(bench):
    """150 N along the bar, by the work that it does on turned joints, with half of every joint's friction beside."""
    coulomb_nm = np.concatenate([arm.coulomb_nm for arm in bench.cell.arms])
    force = held_force(bench, bench.held_nm((150.0, 0.0, 0.0)) + 0.5 * coulomb_nm, 0.0)
    assert 75.0 < force[0] < 150.0


def test_a_sync_that_one_arm_does_not_answer_leaves_the_force_as_it_is(bench):
    still = np.zeros(6)
    bench.balance.begin(ModelUncertainty(constants_of(12)))
    bench.balance.take(400, (None, Shown(still, still, still, still)), None)
    assert bench.balance.wrench is None
    assert bench.balance.inputs(400) is None


@pytest.mark.slow
def test_intervals_hold_what_they_say_where_constants_are_drawn(bench):
    """30 draws of joint friction and of a varying force; 95 % of the rows, within the scatter of 30 draws."""
    random = np.random.default_rng(3)
    inside, half = [], []
    for _ in range(30):
        extra = []
        for arm in (0, 1):
            off = COULOMB_SHARE * random.standard_normal(6) * bench.cell.arms[arm].coulomb_nm
            turning = np.stack([bench.turns(arm, joint) for joint in range(6)], axis=1)
            extra.append(
                off * turning
                + SAMPLE_SHARE * bench.cell.arms[arm].torque_limit_nm * 0.3 * random.standard_normal(turning.shape)
            )
        time = np.linspace(0.0, 6.0, len(bench.path))[:, None]
        force = 15.0 * random.standard_normal(3) * np.sin(time + random.uniform(0.0, 6.0, 3))
        uncertainty = bench.learn_from(force, (extra[0], extra[1]))
        found = bench.balance.internal_force()
        delay = bench.balance.delay
        wrong = found.wrench[40:-60, :3] - force[40 + delay : delay - 60]
        inside.append((np.abs(wrong) < 1.96 * found.std[40:-60, :3]).mean())
        half.append(np.median(1.96 * found.std[:, :3]))
        assert uncertainty.covariance.shape == (64, 64)
    assert np.mean(inside) > 0.93
    assert np.median(half) < 10.0
