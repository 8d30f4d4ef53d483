"""Limits at every SYNC, and the test for standing still."""

from dataclasses import replace

import numpy as np
import pytest

from drives.drive import DriveReading
from drives.errors import IncompleteEpochs
from gateway.acquire.plan import travel_limits
from gateway.acquire.settle import SettleTest
from gateway.data.visit import ArmSample
from gateway.errors import LimitExceeded
from gateway.motion.reactions import ARM_RULES
from gateway.motion.trajectory import straight
from gateway.motion.watch import FOLLOW_RAD, Watch

PERIOD_S = 0.01
IN_A_ROW = ARM_RULES["limits"].count
ANSWER = DriveReading(1, 1, 0x1237, 0, 0, None, None, 0.0, 0.0, None, None)
ZERO = np.zeros(6)


def sample(index: int, q_rad: np.ndarray, torque_nm: np.ndarray = ZERO, unresponsive: int = 0) -> ArmSample:
    readings = (None,) * unresponsive + (ANSWER,) * (6 - unresponsive)
    return ArmSample(index, index * PERIOD_S, q_rad, torque_nm, readings)


@pytest.fixture
def watch(workspace) -> Watch:
    return Watch("main", workspace, PERIOD_S)


def stream(watch: Watch, samples: list[ArmSample], targets: list[np.ndarray]) -> int:
    """SYNCs until the watch refuses; -1 if it never does."""
    for number, (each, target) in enumerate(zip(samples, targets, strict=True)):
        try:
            watch.check(each, target, ZERO)
        except LimitExceeded:
            return number
    return -1


def joint(number: int, value: float) -> np.ndarray:
    out = np.zeros(6)
    out[number - 1] = value
    return out


def test_a_motion_within_the_limits_passes(watch, workspace):
    q = [joint(4, 0.9 * workspace.speed_rad_s[3] * PERIOD_S * k) for k in range(100)]
    assert stream(watch, [sample(k, each) for k, each in enumerate(q)], q) == -1


def test_torque_has_to_last(watch, workspace):
    torque = joint(5, -1.01 * workspace.torque_nm[4])
    bursts = [torque if k % 5 < IN_A_ROW - 1 else ZERO for k in range(100)]
    assert stream(watch, [sample(k, ZERO, each / 5) for k, each in enumerate(bursts)], [ZERO] * 100) == -1
    lasting = [ZERO] * 20 + [torque] * 20
    assert stream(watch, [sample(100 + k, ZERO, each) for k, each in enumerate(lasting)], [ZERO] * 40) == 22


def test_range_is_refused_at_once(watch, workspace):
    q = joint(2, workspace.upper_rad[1] + 0.03)
    with pytest.raises(LimitExceeded, match="joint 2 is at .* outside its range") as refused:
        watch.check(sample(1, q), q, ZERO)
    assert refused.value.joint == 2
    assert refused.value.exit_code == 5


def test_overspeed(watch, workspace):
    speed = 1.5 * workspace.speed_rad_s[0]
    q = [joint(1, speed * PERIOD_S * k) for k in range(30)]
    at = stream(watch, [sample(k, each) for k, each in enumerate(q)], q)
    assert 2 <= at <= 6


def test_following_error(watch, workspace):
    target = joint(6, workspace.following_error_rad[5] * 1.01)
    assert stream(watch, [sample(k, ZERO) for k in range(10)], [target] * 10) == IN_A_ROW - 1


def test_speed_is_measured_over_the_syncs_that_passed(watch, workspace):
    """A gap of four SYNCs does not count as a jump."""
    speed = workspace.speed_rad_s[0]
    index = [0, 1, 2, 7, 8, 9, 14, 15, 16]
    q = [joint(1, speed * PERIOD_S * k) for k in index]
    assert stream(watch, [sample(k, each) for k, each in zip(index, q, strict=True)], q) == -1


def test_incomplete_samples_show_nothing(watch, workspace):
    nothing = np.full(6, np.nan)
    samples = [sample(k, nothing, nothing, unresponsive=1) for k in range(20)]
    assert stream(watch, samples, [ZERO] * 20) == -1


@pytest.mark.parametrize(("extra", "stops"), [(0.0, False), (0.3, True)])
def test_reversal_of_a_loaded_gear_is_no_contact(watch, workspace, extra, stops):
    """0.8 of the limit carried behind the gear: the reading falls from g / eta to g eta when the motion turns."""
    eta = workspace.efficiency[1]
    carried = 0.8 * workspace.torque_nm[1]
    before, after = joint(2, carried), joint(2, carried * eta**2 - extra * workspace.torque_nm[1])
    samples = [sample(k, ZERO, before if k < 100 else after) for k in range(200)]
    at = stream(watch, samples, [ZERO] * 200)
    assert at == (102 if stops else -1)


def test_torque_that_swings_with_delayed_setpoints_is_no_contact(watch, workspace):
    swing = 0.6 * workspace.torque_nm[3] * np.tile([1.0, -1.0, -1.0], 40)
    samples = [sample(k, ZERO, joint(4, value)) for k, value in enumerate(swing)]
    assert stream(watch, samples, [ZERO] * 120) == -1


def test_a_joint_that_is_stuck_is_seen_before_the_following_error(watch, workspace):
    speed = 0.5 * workspace.speed_rad_s[3]
    targets = [joint(4, speed * PERIOD_S * k) for k in range(60)]
    at = stream(watch, [sample(k, ZERO) for k in range(60)], targets)
    assert targets[at][3] < 0.5 * workspace.following_error_rad[3]


def test_a_joint_that_lags_and_is_turned_round_is_not_stuck(watch, workspace):
    """First-order lag of 33 ms: 0.047 rad at full speed of joint 6."""
    limits = travel_limits(workspace)
    there = straight(ZERO, joint(6, 1.5), limits, PERIOD_S).q_rad
    back = straight(joint(6, 1.5), ZERO, limits, PERIOD_S).q_rad
    targets = np.vstack([there, back])
    q, seen = 0.0, []
    for target in targets[:, 5]:
        seen.append(q)
        q += (target - q) * (1 - np.exp(-PERIOD_S / 0.033))
    assert np.abs(targets[:, 5] - seen).max() > 0.04
    samples = [sample(k, joint(6, value)) for k, value in enumerate(seen)]
    assert stream(watch, samples, list(targets)) == -1


def test_modelled_torque_is_gravity(watch, workspace):
    q_rad = np.random.default_rng(0).uniform(-1, 1, (5, 6))
    torque = np.abs(watch.modelled_torque(q_rad)) / workspace.efficiency
    assert torque == pytest.approx(workspace.holding_torque(q_rad))


class TestSettle:
    """The arm is at rest when nothing moves beyond noise."""

    limit_nm = np.full(6, 100.0)

    def run(self, q_of_t, torque_of_t, noise_nm: float = 0.0, seconds: float = 3.0) -> float:
        """Return the time until it is at rest; infinite if it never is."""
        random = np.random.default_rng(1)
        test = SettleTest(PERIOD_S, self.limit_nm)
        for row in range(int(seconds / PERIOD_S)):
            t = row * PERIOD_S
            test.add(np.full(6, q_of_t(t)), torque_of_t(t) + noise_nm * random.normal(size=6))
            restless = test.restless()
            if restless is not None and not restless.any():
                return t
        return np.inf

    @pytest.mark.parametrize("noise_nm", [0.0, 0.1, 5.0])
    def test_noise_alone_is_rest(self, noise_nm):
        assert self.run(lambda t: 0.3, lambda t: 20.0, noise_nm) < 0.6

    def test_a_decaying_swing_is_waited_for(self):
        time_s = self.run(lambda t: 0.3, lambda t: 20.0 + 5.0 * np.exp(-t / 0.3) * np.cos(20 * t), 0.05)
        assert 0.8 < time_s < 2.2

    @pytest.mark.parametrize("period_s", [0.2, 0.5, 0.9, 1.5])
    def test_a_lasting_swing_never_settles(self, period_s):
        assert self.run(lambda t: 0.3, lambda t: 5.0 * np.sin(2 * np.pi * t / period_s), 0.1) == np.inf

    def test_a_creeping_joint_never_settles(self):
        assert self.run(lambda t: 0.003 * t, lambda t: 20.0, 0.1) == np.inf

    def test_a_torque_that_drifts_never_settles(self):
        assert self.run(lambda t: 0.3, lambda t: 5.0 * t, 0.2) == np.inf

    def test_the_restless_joint_is_named(self):
        test = SettleTest(PERIOD_S, self.limit_nm)
        for row in range(60):
            test.add(np.zeros(6), joint(4, row * 0.1))
        assert test.restless().tolist() == [False, False, False, True, False, False]


def delayed(index: int, extra_s: float, torque_nm: np.ndarray = ZERO) -> ArmSample:
    return ArmSample(index, index * PERIOD_S + extra_s, ZERO, torque_nm, (ANSWER,) * 6)


def test_one_delayed_sync_is_no_contact_and_a_contact_after_it_is(watch, workspace):
    jump = joint(2, 0.5 * workspace.torque_nm[1])
    quiet = [delayed(k, 0.0) for k in range(60)]
    shaken = [delayed(60 + k, 0.02, jump if k < 10 else ZERO) for k in range(40)]
    assert stream(watch, quiet + shaken, [ZERO] * 100) == -1
    assert stream(watch, [delayed(100 + k, 0.02, jump) for k in range(10)], [ZERO] * 10) == IN_A_ROW - 1


def test_a_rhythm_that_is_not_kept_stops_the_arm(watch):
    for k in range(30):
        watch.check(delayed(k, 0.02 * k), ZERO, ZERO)
    share = int(ARM_RULES["rhythm"].limit * 2.0 / PERIOD_S)
    for k in range(30, share + 1):
        watch.check(delayed(k, 0.02 * k), ZERO, ZERO)
    with pytest.raises(IncompleteEpochs, match="SYNCs were delayed"):
        watch.check(delayed(share + 1, 0.02 * (share + 1)), ZERO, ZERO)


@pytest.mark.parametrize(("delayed", "allowed", "fine"), [(6, 2.0, True), (8, 2.0, False), (6, 0.0, False)])
def test_in_real_time_a_drive_may_take_its_setpoints_with_delay(workspace, delayed, allowed, fine):
    """The lag of a drive that buffers setpoints does not count as a following error."""
    period_s = 0.05
    step = workspace.following_error_rad[5] / 3.0
    targets = [joint(6, step * (row - delayed)) for row in range(40)]
    sent = [*targets[delayed:], *[targets[-1]] * delayed]
    watch = Watch("main", workspace, period_s, allowed)
    samples = [ArmSample(row, row * period_s, q, ZERO, (ANSWER,) * 6) for row, q in enumerate(targets)]
    # a target that goes out with a SYNC is reached one SYNC later at the soonest
    assert (stream(watch, samples[1:20], sent[:19]) == -1) == fine


# ------------------------------------------------------------------------------------------- limits by their numbers


@pytest.mark.parametrize(("period_s", "share", "stops"), [(0.001, 1.5, True), (0.001, 1.1, False), (0.01, 1.5, True)])
def test_speed_is_measured_over_a_span_that_does_not_see_the_noise(workspace, period_s, share, stops):
    """Of 20 ms: readings that jump to and fro by half a milliradian are 0.5 rad/s from one millisecond to the next."""
    limit = workspace.speed_rad_s[5]
    q = [joint(6, share * limit * period_s * k + (-1) ** k * 2.5e-4) for k in range(100)]
    watch = Watch("main", workspace, period_s)
    samples = [ArmSample(k, k * period_s, each, ZERO, (ANSWER,) * 6) for k, each in enumerate(q)]
    at = stream(watch, samples, q)
    assert (at >= 0) == stops
    assert at * period_s <= 0.1


@pytest.mark.parametrize(("share", "stops"), [(0.99, False), (1.01, True)])
@pytest.mark.parametrize("sign", [1, -1])
def test_each_limit_holds_to_either_side(workspace, share, stops, sign):
    target = [joint(3, sign * share * workspace.following_error_rad[2])] * 20
    assert (stream(Watch("main", workspace, PERIOD_S), [sample(k, ZERO) for k in range(20)], target) >= 0) == stops
    slow = [joint(3, sign * share * workspace.torque_nm[2]) * min(1.0, k / 400) for k in range(440)]
    samples = [sample(k, ZERO, each) for k, each in enumerate(slow)]
    assert (stream(Watch("main", workspace, PERIOD_S), samples, [ZERO] * len(slow)) >= 0) == stops


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("beyond", "stops"), [(0.019, False), (0.021, True)])
def test_a_joint_may_stand_a_little_beyond_its_range(workspace, side, beyond, stops):
    """By control and rounding: 0.02 rad."""
    edge = workspace.upper_rad[1] if side > 0 else workspace.lower_rad[1]
    q = joint(2, edge + side * beyond)
    watch = Watch("main", workspace, PERIOD_S)
    watch.start(joint(2, edge))
    assert (stream(watch, [sample(k, q) for k in range(5)], [q] * 5) >= 0) == stops


@pytest.mark.parametrize("side", [1, -1])
def test_a_joint_outside_its_range_may_move_in_and_never_out_again(workspace, side):
    """0.1 rad outside; after a third of the path inwards it reverses."""
    edge = workspace.upper_rad[1] if side > 0 else workspace.lower_rad[1]
    begin = edge + side * 0.1
    watch = Watch("main", workspace, PERIOD_S)
    watch.start(joint(2, begin))
    inward = [joint(2, begin - side * 0.001 * k) for k in range(34)]
    assert stream(watch, [sample(k, each) for k, each in enumerate(inward)], inward) == -1
    out = [joint(2, begin - side * (0.033 - 0.001 * k)) for k in range(34)]
    at = stream(watch, [sample(40 + k, each) for k, each in enumerate(out)], out)
    assert 18 <= at <= 22
    inside = Watch("main", workspace, PERIOD_S)
    inside.start(joint(2, begin))
    home = [joint(2, begin - side * 0.005 * k) for k in range(60)]
    assert stream(inside, [sample(k, each) for k, each in enumerate(home)], home) == -1
    with pytest.raises(LimitExceeded, match="outside its range"):
        inside.check(sample(70, joint(2, edge + side * 0.03)), joint(2, edge + side * 0.03), ZERO)


def test_an_arm_whose_links_are_not_known_is_not_modelled(workspace):
    unknown = Watch("main", replace(workspace, links=None), PERIOD_S)
    assert np.array_equal(unknown.modelled_torque(np.ones((4, 6))), np.zeros((4, 6)))
    assert Watch("main", workspace, PERIOD_S).modelled_torque(np.empty((0, 6))).shape == (0, 6)


@pytest.mark.parametrize(("period_s", "delay_s", "counts"), [(0.01, 0.0049, False), (0.01, 0.0051, True)])
def test_a_sync_counts_as_delayed_from_half_a_period_on(workspace, period_s, delay_s, counts):
    """Every third one, for longer than the rule looks at."""
    watch = Watch("main", workspace, period_s)

    def run() -> None:
        for k in range(600):
            shift = delay_s if k % 3 == 2 else 0.0
            watch.check(ArmSample(k, k * period_s + shift, ZERO, ZERO, (ANSWER,) * 6), ZERO, ZERO)

    assert ARM_RULES["rhythm"].limit < 1 / 3
    if counts:
        with pytest.raises(IncompleteEpochs, match="SYNCs were delayed"):
            run()
    else:
        run()


def test_a_stuck_joint_is_named_with_its_command(watch, workspace):
    def move() -> None:
        for k in range(200):
            watch.check(sample(k, ZERO), joint(4, -0.001 * k), ZERO)

    with pytest.raises(
        LimitExceeded, match=r"joint 4 was commanded to move by -0\.\d+ rad but has moved by 0\.000 rad"
    ):
        move()


@pytest.mark.parametrize(("share", "stops"), [(0.15, True), (0.3, False)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_joint_has_to_go_a_fifth_of_its_command(workspace, share, stops, sign):
    """Slowly, so that no other limit is left before."""
    far = FOLLOW_RAD * 1.5
    targets = [joint(1, sign * 0.0005 * k) for k in range(int(far / 0.0005))]
    wide = replace(workspace, following_error_rad=np.full(6, 1.0))
    watch = Watch("main", wide, PERIOD_S)
    samples = [sample(k, share * each) for k, each in enumerate(targets)]
    assert (stream(watch, samples, targets) >= 0) == stops


def test_contact_is_looked_for_after_the_brakes_are_open_and_named_with_its_joint(workspace):
    quiet = 60
    jump = joint(5, -0.5 * workspace.torque_nm[4])
    watch = Watch("main", workspace, PERIOD_S)
    for k in range(quiet):
        watch.check(sample(k, ZERO), ZERO, ZERO)
    watch.check(sample(quiet, ZERO, jump), ZERO, ZERO)
    watch.check(sample(quiet + 1, ZERO, jump), ZERO, ZERO)
    with pytest.raises(LimitExceeded, match="joint 5: the torque has jumped by") as caught:
        watch.check(sample(quiet + 2, ZERO, jump), ZERO, ZERO)
    assert caught.value.joint == 5
