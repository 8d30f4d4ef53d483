"""Arms under one clock: brought up together, one SYNC each, stopped together whichever fails first."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from drives.bus import Bus, BusSpec
from drives.errors import DriveFault, StopRequested
from drives.group import DriveGroup
from drives.profile_file import load_profile
from drives.values import AxisSetup
from gateway.motion.arm import Arm
from gateway.motion.arms import Arms
from tests.drives.conftest import Beside, Slave, Wire, on_its_clock
from tests.gateway.conftest import BAND_NM, FakeDrives

#: Of a SYNC that arms share in real time.
PARTS = ("begin", "prepare", "sync", "gather", "check")
#: Longest time that disabling six slaves may take [s].
PATIENCE_S = 20.0


class Drives(FakeDrives):
    """Drives that note their SYNCs in real time and notify the other arms before they stop because of a fault."""

    def __init__(self, axes, gravity) -> None:
        super().__init__(axes, gravity, BAND_NM)
        self.sent_s = 0.0
        self.aligned_s: float | None = None
        self.ahead_s: float | None = None
        self.refused: Exception | None = None

    def enable(self, stop_requested=lambda: False):
        self.log.append("enable")
        if self.refused is not None:
            raise self.refused
        if stop_requested():
            raise StopRequested("a stop was asked for")
        self.enabled = True
        return self._epoch()

    def exchange(self, commands, /):
        try:
            return super().exchange(commands)
        except DriveFault:
            if not self.log_of_parts:
                self.on_stop()
            raise

    def sync(self):
        self.sent_s = time.monotonic()
        super().sync()

    def check(self, epoch, /):
        if self.failed is not None:
            self.on_stop()
        super().check(epoch)

    @property
    def sync_sent_s(self):
        return self.sent_s

    def align(self, at_s):
        self.aligned_s, self.ahead_s = at_s, at_s - time.monotonic()


@pytest.fixture
def drives(fake) -> tuple[Drives, Drives]:
    return Drives(fake.axes, fake.gravity), Drives(fake.axes, fake.gravity)


@pytest.fixture(params=["lockstep", "real"])
def pair(request, drives) -> Iterator[Arms]:
    arms = Arms(
        [Arm(name, each, each.axes) for name, each in zip(("left", "right"), drives, strict=True)], request.param
    )
    yield arms
    arms.close()


def up(arms: Arms) -> None:
    assert not arms.enabled
    arms.enable(lambda: False)
    assert arms.enabled


def commands(arms: Arms, to: float = 0.0) -> list:
    return [arm.command(np.full(6, to)) for arm in arms.members]


def test_arms_are_joined_with_commas_and_and(pair):
    assert pair.names == "'left' and 'right'"


def test_each_arm_reports_its_position_and_follows_its_own_targets(pair, drives):
    drives[1].q_rad = np.full(6, 0.2)
    left, right = pair.where()
    assert (left, right) == (pytest.approx(np.zeros(6)), pytest.approx(np.full(6, 0.2)))
    up(pair)
    pair.exchange([pair.members[0].command(np.full(6, 0.1)), pair.members[1].command(np.full(6, -0.1))])
    left, right = pair.hold()
    assert left.q_rad == pytest.approx(np.full(6, 0.1), abs=1e-4)
    assert right.q_rad == pytest.approx(np.full(6, -0.1), abs=1e-4)
    pair.disable()
    assert not pair.enabled
    assert [each.log for each in drives] == [["enable", "disable"]] * 2


def test_an_arm_that_is_ready_holds_until_the_other_one_is(pair, drives):
    slow = threading.Event()
    plain = drives[1].enable

    def enable(stop_requested):
        slow.wait(5.0)
        return plain(stop_requested)

    drives[1].enable = enable  # type: ignore[method-assign]
    held = drives[0].hold

    def hold():
        if drives[0].sync_index > 5:
            slow.set()
        return held()

    drives[0].hold = hold  # type: ignore[method-assign]
    pair.enable(lambda: False)
    assert drives[0].sync_index > 5


def test_an_arm_that_waits_for_another_one_does_not_run_away_with_the_time(drives):
    """In lockstep every SYNC is a step of simulated time: it may not pass much faster than it really does."""
    pair = Arms([Arm(name, each, each.axes) for name, each in zip("ab", drives, strict=True)], "lockstep")
    held, plain, slow = [], drives[0].hold, drives[1].enable

    def hold():
        held.append(time.monotonic())
        return plain()

    def enable(stop_requested):
        time.sleep(0.2)
        return slow(stop_requested)

    drives[0].hold, drives[1].enable = hold, enable
    pair.enable(lambda: False)
    pair.close()
    assert len(held) > 1
    assert np.diff(held).min() > 0.005


def test_set_points_begin_where_every_joint_was_seen(pair, drives):
    """A drive of the arm that waits leaves SYNCs unanswered: its setpoints must begin at its position."""
    slow = threading.Event()
    plain, held = drives[1].enable, drives[0].hold

    def enable(stop_requested):
        slow.wait(5.0)
        return plain(stop_requested)

    def hold():
        drives[0].unanswered[drives[0].sync_index + 1] = 3
        if drives[0].sync_index > 5:
            slow.set()
        return held()

    drives[1].enable = enable  # type: ignore[method-assign]
    drives[0].hold = hold  # type: ignore[method-assign]
    for sample in pair.enable(lambda: False):
        assert np.isfinite(sample.q_rad).all()


@pytest.mark.parametrize("failing", [0, 1])
def test_one_arm_that_cannot_be_enabled_leaves_none_under_power(pair, drives, failing):
    """What is raised is the drive's error, not that the other arm gave up because of it."""
    drives[failing].refused = DriveFault("is in FAULT", node=4)
    with pytest.raises(DriveFault, match="is in FAULT"):
        pair.enable(lambda: False)
    assert [each.log[-1] for each in drives] == ["disable"] * 2
    assert not pair.enabled
    assert not any(each.enabled for each in drives)


def test_a_stop_request_during_enabling_enables_nothing(pair, drives):
    with pytest.raises(StopRequested):
        pair.enable(lambda: True)
    assert [each.log[-1] for each in drives] == ["disable"] * 2
    assert not pair.enabled


def test_arms_that_fail_both_are_named_both(pair, drives):
    for each, node in zip(drives, (3, 5), strict=True):
        each.refused = DriveFault("is in FAULT", node=node)
    with pytest.raises(DriveFault, match="node 3") as caught:
        pair.enable(lambda: False)
    assert caught.value.__notes__ == ["another arm: node 5: is in FAULT"]


@pytest.mark.parametrize("failing", [0, 1])
def test_a_fault_of_one_arm_stops_the_other_by_its_ramp(pair, drives, failing):
    up(pair)
    for _ in range(3):
        pair.exchange(commands(pair))
    drives[failing].fault_at = drives[failing].sync_index + 1
    with pytest.raises(DriveFault, match="left OPERATION ENABLED"):
        pair.exchange(commands(pair))
    assert drives[1 - failing].log == ["enable", "quick stop"]
    assert not pair.enabled
    pair.disable()
    assert [each.log[-1] for each in drives] == ["disable"] * 2


def test_after_a_stop_no_arm_is_stopped_a_second_time(pair, drives):
    up(pair)
    pair.quick_stop()
    assert [each.log for each in drives] == [["enable", "quick stop"]] * 2
    drives[0].on_stop()
    pair.close()
    assert [each.log for each in drives] == [["enable", "quick stop"]] * 2


def test_by_the_clock_arms_begin_together_and_the_time_between_their_syncs_is_kept(pair, drives):
    up(pair)
    for _ in range(4):
        pair.exchange(commands(pair))
    first, second = (each.aligned_s for each in drives)
    ahead = [each.ahead_s for each in drives]
    if not pair.real:
        assert (first, second, len(pair.skew_s)) == (None, None, 0)
        return
    assert first == second
    assert all(0.0 < each <= 0.05 for each in ahead)
    assert len(pair.skew_s) == 4
    assert pair.skew_s[-1] == drives[1].sent_s - drives[0].sent_s


@pytest.mark.parametrize("held", [False, True])
def test_by_the_clock_each_part_of_a_sync_is_done_for_all_arms_before_the_next_one(drives, held):
    arms = Arms([Arm(str(index), each, each.axes) for index, each in enumerate(drives)], "real")
    up(arms)
    seen, due_s = [], []
    for index, each in enumerate(drives):
        for part in PARTS:
            plain = getattr(each, part)

            def noted(*arguments, index=index, part=part, plain=plain):
                seen.append((part, index, threading.current_thread()))
                due_s.extend(arguments if part == "prepare" else ())
                return plain(*arguments)

            setattr(each, part, noted)
    for _ in range(2):
        arms.hold() if held else arms.exchange(commands(arms, 0.1))
    parts = [(part, index) for part in PARTS for index in (0, 1)]
    assert [each[:2] for each in seen] == parts * 2
    assert {thread for *_, thread in seen} == {threading.main_thread()}
    assert due_s == [None, 12.0] * 2  # one clock for both
    arms.close()


@pytest.mark.parametrize("part", PARTS[:4])
def test_a_sync_that_one_arm_cannot_take_part_in_is_left_by_all(drives, part):
    arms = Arms([Arm(str(index), each, each.axes) for index, each in enumerate(drives)], "real")
    up(arms)
    before = [each.q_rad for each in drives]

    def fails(*_arguments):
        raise KeyboardInterrupt

    setattr(drives[1], part, fails)
    with pytest.raises(KeyboardInterrupt):
        arms.exchange(commands(arms, 0.1))
    assert [each.log_of_parts[-1] for each in drives] == ["abandon"] * 2
    if part != "gather":
        assert all((each.q_rad == at).all() for each, at in zip(drives, before, strict=True))
    arms.close()


def test_arms_whose_sync_was_interrupted_are_disabled_from_other_threads(fake, monkeypatch):
    """The bus of an arm belongs to the thread that has begun a SYNC until it is abandoned."""
    first, members, profile = Wire(), [], load_profile("generic-cia402")
    on_its_clock(first, monkeypatch)
    wires, setups = [first, Beside(first)], [AxisSetup(node_id, profile, 0.5, 300.0) for node_id in range(1, 7)]
    for each in wires:
        each.slaves += [Slave(each, node_id) for node_id in range(1, 7)]
        group = DriveGroup(Bus(each, BusSpec("test", "wire")), setups, 0.01)  # type: ignore[arg-type]
        group.connect()
        group.configure()
        members.append(Arm(str(len(members)), group, fake.axes))
    arms = Arms(members, "real")  # which shares each SYNC in parts; the clock of both groups is that of the wire
    arms.enable(lambda: False)
    send = wires[1].send

    def interrupted(message, timeout=None):
        if message.arbitration_id == 0x080:
            raise KeyboardInterrupt
        send(message, timeout)

    monkeypatch.setattr(wires[1], "send", interrupted)
    with pytest.raises(KeyboardInterrupt):
        arms.hold()
    monkeypatch.setattr(wires[1], "send", send)
    disabling = threading.Thread(target=arms.disable, daemon=True)
    disabling.start()
    disabling.join(PATIENCE_S)
    assert not disabling.is_alive()
    assert {slave.state for each in wires for slave in each.slaves} == {"switch on disabled"}
    arms.close()


def test_who_is_in_the_middle_of_a_sync_leaves_it_before_being_stopped(drives):
    """The thread that stops an arm could not use its bus otherwise until the other arm is at rest."""
    arms = Arms([Arm(str(index), each, each.axes) for index, each in enumerate(drives)], "real")
    up(arms)
    order = []
    drives[0].abandon = lambda: order.append("abandon")  # type: ignore[method-assign]
    drives[0].quick_stop = lambda: order.append("quick stop")  # type: ignore[method-assign]

    def fails():
        drives[1].on_stop()
        while "quick stop" not in order:  # the other arm is stopped while this one is being stopped here
            time.sleep(0.001)
        raise DriveFault("left OPERATION ENABLED: FAULT", node=3)

    drives[1].sync = fails  # type: ignore[method-assign]
    with pytest.raises(DriveFault):
        arms.exchange(commands(arms))
    assert order[:2] == ["abandon", "quick stop"]
    assert not arms.enabled
    arms.close()


def test_in_lockstep_the_arms_are_served_in_turn_by_one_thread(drives):
    arms = Arms([Arm(str(index), each, each.axes) for index, each in enumerate(drives)], "lockstep")
    up(arms)
    seen = []
    for index, each in enumerate(drives):
        plain = each.exchange
        each.exchange = lambda arguments, index=index, plain=plain: (  # type: ignore[method-assign]
            seen.append((index, threading.current_thread())) or plain(arguments)
        )
    for _ in range(3):
        arms.exchange(commands(arms))
    assert [index for index, _ in seen] == [0, 1] * 3
    assert {thread for _, thread in seen} == {threading.main_thread()}
    arms.close()


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_a_single_arm_needs_no_thread(drives, pacing):
    before = threading.active_count()
    arms = Arms([Arm("only", drives[0], drives[0].axes)], pacing)
    assert arms.names == "'only'"
    up(arms)
    arms.exchange(commands(arms))
    assert drives[0].aligned_s is None
    assert len(arms.skew_s) == 0
    assert threading.active_count() == before
    arms.quick_stop()
    arms.disable()
    arms.close()
    assert drives[0].log == ["enable", "quick stop", "disable"]


# -- one arm -----------------------------------------------------------------------------------------------------------


def test_targets_and_torque_offsets_go_through_gear_and_sign(arm, fake):
    """Power is the same on both sides: motor torque x motor speed = joint torque x joint speed."""
    rng = np.random.default_rng(3)
    q_rad, torque_nm, speed = rng.uniform(-1, 1, 6), rng.uniform(-50, 50, 6), rng.normal(size=6)
    plain, fed = arm.command(q_rad), arm.command(q_rad, q_rad, torque_nm)
    assert [each.position_rad for each in plain] == [each.position_rad for each in fed]
    assert [each.torque_offset_nm for each in plain] == [0.0] * 6
    ratio = fake.axes.ratio
    motor_speed = fake.axes.motor_velocity(speed)
    power = sum(each.torque_offset_nm * each_s for each, each_s in zip(fed, motor_speed, strict=True))
    assert power == pytest.approx(torque_nm @ speed)
    moved = arm.command(q_rad + speed * 1e-3)
    turned = [after.position_rad - before.position_rad for after, before in zip(moved, plain, strict=True)]
    assert np.abs(turned) == pytest.approx(np.abs(ratio * speed * 1e-3))


def test_a_drive_that_does_not_respond_leaves_its_joint_without_a_number(arm, fake):
    fake.unanswered = {fake.sync_index + 1: 3}
    fake.enabled = True
    sample = arm.hold()
    assert not sample.complete
    assert np.isnan(sample.q_rad[3])
    assert arm.hold().complete


def test_drop_is_a_bound_at_the_joints(arm, fake):
    fake.brake_drop_rad = np.abs(fake.axes.ratio * 0.01).tolist()
    assert arm.brake_drop_rad() == pytest.approx(np.full(6, 0.01))


def test_measured_torque_is_that_of_the_joints(pair, drives):
    """What the arm weighs there, within a bit of each drive's torque word."""
    up(pair)
    q_rad = np.array([0.1, 0.4, -0.3, 0.2, 0.1, 0.0])
    pair.exchange([arm.command(q_rad) for arm in pair.members])
    for each in drives:
        each.band_nm = np.zeros(6)
    sample, _ = pair.hold()
    bit_nm = np.abs(drives[0].axes.joint_torque(np.full(6, drives[0].scale.torque_nm)))
    assert (np.abs(sample.joint_torque_nm - drives[0].gravity(q_rad)) <= bit_nm).all()
