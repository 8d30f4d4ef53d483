"""Preparation of a path of a pair, its refusals, and the transfer of both arms to its start."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import Mock

import numpy as np
import pytest

from gateway.errors import LimitExceeded, PlanRefused
from gateway.motion.observer import Observers
from gateway.motion.power import powered
from gateway.motion.stops import StopKind
from gateway.motion.stream import MoveOptions
from gateway.pair.gap import gap_layout, instruments_on
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import APPROACH_RAD_S, APPROACH_S, PairMotion, calibration_of, refuse_unreachable
from tests.gateway.pair.together import EXAMPLE, Together


@pytest.fixture
def pair() -> Iterator[Together]:
    pair = Together(np.zeros(6))
    yield pair
    pair.arms.close()


@pytest.fixture(scope="module")
def distance_cell():
    return load_pair(EXAMPLE / "distance.toml", pacing="lockstep")


def test_a_controller_uses_the_cells_part_and_chain(pair, distance_cell):
    found, stiffness = calibration_of(pair.cell), pair.cell.config.force.stiffness
    assert found.part_mass_kg == pair.cell.config.part_mass_kg
    assert np.diag(found.chain_stiffness).tolist() == [stiffness.straight] * 3 + [stiffness.turned] * 3
    assert found.loop_time_s == pair.cell.config.loop_delay_s
    nothing = calibration_of(distance_cell)
    assert nothing.part_mass_kg == 0.0
    assert nothing.loop_time_s == distance_cell.config.loop_delay_s


@pytest.mark.parametrize(("share", "refused"), [(0.99, False), (1.01, True)])
def test_a_joint_that_would_turn_too_fast_is_named(pair, share, refused):
    workspace, arm = pair.link.opened[0].workspace, pair.cell.arms[0]
    rows = np.tile(arm.start_rad, (20, 1))
    rows[:, 4] += share * workspace.speed_rad_s[4] * 0.004 * np.arange(20) * np.sign(-arm.start_rad[4])
    if refused:
        with pytest.raises(LimitExceeded, match=r"arm 'left', joint 5 would turn with .* lower the speed") as caught:
            refuse_unreachable("left", workspace, rows, 0.004)
        assert caught.value.joint == 5
    else:
        refuse_unreachable("left", workspace, rows, 0.004)


def test_a_posture_that_is_not_allowed_is_named_with_its_command(pair):
    workspace, arm = pair.link.opened[0].workspace, pair.cell.arms[0]
    rows = np.tile(arm.start_rad, (9, 1))
    rows[6:, 1] = workspace.upper_rad[1] + 0.1
    with pytest.raises(PlanRefused, match=r"arm 'left', command [67] at \[.*joint 2 outside.*move the path"):
        refuse_unreachable("left", workspace, rows, 10.0)


@pytest.mark.parametrize("away_rad", [0.005, 0.08])
def test_both_arms_come_slowly_and_at_the_same_time_to_the_start_of_a_path(pair, away_rad):
    pair.part.stiffness = (0.0, 0.0)
    observer = Mock()
    stream = pair.link.stream(pair.cell, MoveOptions(observers=Observers(observer)))
    motion = PairMotion(pair.cell, stream)
    goal = tuple(arm.start_rad + away_rad * np.array([0.2, -1.0, 0.5, 0, 0.1, 0]) for arm in pair.cell.arms)
    with powered(stream):
        motion.start()
        before = pair.drives[0].sync_index
        observer.reset_mock()
        motion.approach(goal, dwell_s=0.1)
        syncs = pair.drives[0].sync_index - before
        path = [np.concatenate(call.args[0].targets_rad) for call in observer.sampled.call_args_list]
    time_s = max(APPROACH_S, away_rad / APPROACH_RAD_S)
    assert syncs == pytest.approx((time_s + 0.1) / 0.004, abs=2)
    assert path[-1] == pytest.approx(np.concatenate(goal), abs=1e-9)
    speed = np.abs(np.diff(path, axis=0)).max() / 0.004
    assert speed == pytest.approx(1.5 * away_rad / time_s, rel=0.02)
    share = (np.array(path) - path[0]) @ (path[-1] - path[0])
    assert (np.diff(share) >= 0).all()


def test_a_gap_out_of_range_is_urgent_and_asked_for_wherever_the_arms_are_powered(pair):
    stream = pair.link.stream(pair.cell, MoveOptions())
    motion = PairMotion(pair.cell, stream)
    motion.ask("too close", StopKind.QUICK_STOP)
    wish = stream.options.desk.look()
    assert wish is not None
    assert (wish.kind, str(wish.cause)) == (StopKind.QUICK_STOP, "too close")


def test_with_a_common_part_nothing_is_added_to_the_torque(pair):
    stream = pair.link.stream(pair.cell, MoveOptions())
    assert PairMotion(pair.cell, stream).offsets((np.zeros(6), np.zeros(6))) is None


def test_a_prepared_trajectory_holds_the_nominal_joints_of_both_arms_and_their_rates(pair):
    stream = pair.link.stream(pair.cell, MoveOptions())
    path = pair.cell.path(1.0)
    seeds = tuple(arm.start_rad for arm in pair.cell.arms)
    rows = PairMotion(pair.cell, stream).prepare_trajectory(path, seeds)
    for arm, joints, to in zip(
        pair.cell.arms, rows.joints, (path.commands, pair.cell.nominal_slave(path)), strict=True
    ):
        assert arm.chain.poses(joints)[0] == pytest.approx(to, abs=1e-7)
    joints = np.hstack(rows.joints)
    assert rows.speed_rad_s[5:-5] == pytest.approx((joints[6:-4] - joints[4:-6]) / (2 * path.dt_s), abs=1e-9)
    speed = rows.speed_rad_s
    assert rows.acceleration_rad_s2[5:-5] == pytest.approx((speed[6:-4] - speed[4:-6]) / (2 * path.dt_s), abs=1e-9)
    for index, arm in enumerate(pair.cell.arms):
        half = slice(6 * index, 6 * index + 6)
        free = arm.model_torque(rows.joints[index], speed[:, half], rows.acceleration_rad_s2[:, half])
        assert rows.free_nm[index] == pytest.approx(free)
    assert np.hstack(rows.targets(7, (path.commands[7], pair.cell.nominal_slave(path)[7]))) == pytest.approx(joints[7])


def test_distance_sensors_at_the_wanted_relation_say_that_nothing_is_to_be_moved(distance_cell):
    """Each plane is where its beam ends there; a hand that is moved along a beam changes its reading."""
    layout = distance_cell.gap
    gaps = np.array([channel.gap_m for channel in layout.config.channel])
    assert layout.estimator.demanded_m == pytest.approx(gaps)
    slave = distance_cell.nominal_slave(distance_cell.path(1.0))[0]
    assert layout.estimator.error_in_base(gaps, slave) == pytest.approx(np.zeros(6), abs=1e-9)
    low, high = layout.config.range_m
    assert layout.limit_m == pytest.approx(min(np.minimum(gaps - low, high - gaps)))


def test_a_device_is_read_on_its_own_bus_alone(pair, distance_cell):
    config = distance_cell.config.distance
    assert [setup.node_id for setup in instruments_on(config.bus, distance_cell.config)] == [config.node_id]
    other = next(arm.config.bus for arm in distance_cell.arms if arm.config.bus != config.bus)
    assert instruments_on(other, distance_cell.config) == ()
    assert instruments_on(config.bus, pair.cell.config) == ()
    assert instruments_on(config.bus, None) == ()


def test_a_beam_is_a_direction_however_long_it_is_written(distance_cell):
    """The same sensors with beams of twice and half the length say the same of any hand."""
    config, wanted = distance_cell.config.distance, distance_cell.nominal_relation
    slave = distance_cell.nominal_slave(distance_cell.path(1.0))[0]
    gaps = np.array([channel.gap_m for channel in config.channel]) + 1e-4 * np.arange(len(config.channel))
    found = []
    for length in (0.5, 1.0, 2.0):
        channels = tuple(
            one.model_copy(update={"beam": tuple(length * value for value in one.beam)}) for one in config.channel
        )
        layout = gap_layout(config.model_copy(update={"channel": channels}), 1, wanted)
        found.append(layout.estimator.error_in_base(gaps, slave))
    assert found[0] == pytest.approx(found[1])
    assert found[2] == pytest.approx(found[1])
    assert np.abs(found[1]).max() > 1e-5
