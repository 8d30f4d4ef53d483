"""Frames received on a bus with another master become the data of the page; nothing is sent."""

from __future__ import annotations

import math
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest

from drives.bus import BusSpec
from drives.emcy import Emergency
from drives.epoch import Epoch
from drives.values import DriveReading
from gateway.cell.conversion import AxisConversion
from gateway.errors import ConfigError, InputError
from gateway.live.feed import PHASES
from gateway.live.watching import SILENT_S, WatchedArm, Watching, stored_constants, watch
from gateway.live.wire import HEAD, PER_AXIS, Ended, Happened, Heard, ShownCell
from gateway.motion.state import Phase

ENABLED, QUICK_STOP, READY = 0x1237, 0x1217, 0x1231
STEP_RAD = 0.01


class FakeListenOnlyBus:
    """Readings of `ListenOnlyBus`, set by the test; motor angles of six axes."""

    def __init__(self) -> None:
        self.bus = SimpleNamespace(listen=lambda _seconds: None)
        self.unknown: tuple[int, ...] = ()
        self.emergencies: deque[Emergency] = deque()
        self.coming: list[Epoch] = []
        self.target_rad: list[float | None] = [None] * 6

    def epochs(self) -> list[Epoch]:
        coming, self.coming = self.coming, []
        return coming

    def targets_rad(self) -> list[float | None]:
        return list(self.target_rad)

    def sync(self, number: int, word: int = ENABLED, unresponsive: int | None = None, motor_rad: float = 0.0) -> None:
        readings = tuple(
            None
            if axis == unresponsive
            else DriveReading(axis + 1, number, word, 0, 0, None, None, motor_rad, 0.0, None, None)
            for axis in range(6)
        )
        self.coming.append(Epoch(number, 0.01 * number, readings))


@pytest.fixture
def received() -> FakeListenOnlyBus:
    return FakeListenOnlyBus()


@pytest.fixture
def config(small_cell):
    return small_cell.cell.arm[0]


@pytest.fixture
def watched(config, workspace, received) -> WatchedArm:
    return WatchedArm(config, workspace, received)


@pytest.fixture
def watching(watched, rig) -> Watching:
    return Watching((watched,), rig.feed, 0.01, lambda: rig.now_s[0])


def rows(rig) -> list[np.ndarray]:
    return [each for each in rig.received() if isinstance(each, np.ndarray)]


def words(rig) -> list[Heard]:
    return [each.event for each in rig.received() if isinstance(each, Happened)]


def test_the_page_receives_first_what_is_watched(watching, rig, watched):
    (stage,) = rig.received()
    assert isinstance(stage, ShownCell)
    assert [arm.name for arm in stage.arms] == [watched.name]


def test_a_sync_becomes_a_row_on_the_side_of_the_joints(watching, rig, received, config):
    axes = AxisConversion.from_arm(config)
    received.sync(1, motor_rad=2.0)
    received.target_rad = [3.0] * 6
    watching.turn()
    (row,) = rows(rig)
    assert row[1] == 1
    place, followed, _, _, status = row[HEAD:].reshape(PER_AXIS, 6)
    assert place == pytest.approx(axes.joint_position(np.full(6, 2.0)))
    assert followed == pytest.approx(axes.joint_position(np.full(6, 3.0)))
    assert status.tolist() == [ENABLED] * 6


def test_a_drive_that_does_not_respond_is_nan_in_its_place_alone(watching, rig, received):
    received.sync(1, unresponsive=2)
    watching.turn()
    (row,) = rows(rig)
    status = row[HEAD:].reshape(PER_AXIS, 6)[4]
    assert np.isnan(status).tolist() == [axis == 2 for axis in range(6)]


@pytest.mark.parametrize(
    ("word", "step_rad", "phase"),
    [
        (ENABLED, STEP_RAD, Phase.MOVING),
        (ENABLED, 0.0, Phase.HOLDING),
        (QUICK_STOP, STEP_RAD, Phase.STOPPING),
        (READY, 0.0, Phase.IN_BRAKES),
    ],
)
def test_the_state_of_an_arm_is_read_from_its_drives_and_their_commands(watching, rig, received, word, step_rad, phase):
    for number in (1, 2, 3):
        received.sync(number, word)
        received.target_rad = [number * step_rad] * 6
        rig.later(0.01)
        watching.turn()
    assert PHASES[int(rows(rig)[-1][3])] is phase


def test_an_arm_is_in_its_brakes_only_if_every_drive_says_so(watching, rig, received):
    received.sync(1, READY, unresponsive=2)
    watching.turn()
    assert PHASES[int(rows(rig)[-1][3])] is Phase.UNKNOWN
    received.sync(2, ENABLED)
    rig.later(0.01)
    watching.turn()
    rig.later(1.1 * SILENT_S)
    watching.turn()
    assert [each.disabled for each in rig.received() if isinstance(each, Ended)] == [False], "SYNC has ended"


def test_without_frames_nothing_is_reported_until_that_is_news(watching, rig, received):
    received.sync(1)
    watching.turn()
    rig.received()
    rig.later(0.9 * SILENT_S)
    watching.turn()
    assert rig.received() == []
    rig.later(0.2 * SILENT_S)
    watching.turn()
    watching.turn()
    assert [word.text for word in words(rig)] == ["no SYNC received: no master is controlling these drives"]
    received.sync(2)
    watching.turn()
    assert len(rows(rig)) == 1


def test_constants_that_were_not_received_are_named_once(watching, watched, rig, received):
    received.unknown = (1, 3)
    again = Watching((watched,), rig.feed, 0.01, lambda: rig.now_s[0])
    for number in (1, 2):
        received.sync(number)
        again.turn()
    (word,) = words(rig)
    assert word.grave == "warn"
    assert "the constants of nodes 1, 3 are unknown" in word.text
    assert "--constants" in word.text


def test_an_emergency_is_reported_with_its_node(watching, rig, received):
    received.emergencies.append(Emergency(4, 7, 0x7305, 0x20, b"", "incremental sensor 1", "check the encoder", False))
    received.emergencies.append(Emergency(4, 8, 0x0000, 0x00, b"", "no error", "", True))
    watching.turn()
    assert [word.grave for word in words(rig)] == ["fail", "plain"]
    assert not received.emergencies


def test_torque_of_the_model_is_unknown_where_a_joint_is(watched, received):
    assert all(map(math.isnan, watched.modelled_nm()))
    received.sync(1, unresponsive=0)
    watched.listen()
    assert all(map(math.isnan, watched.modelled_nm()))
    received.sync(2)
    watched.listen()
    assert np.isfinite(watched.modelled_nm()).all() == (watched.workspace.links is not None)


def test_a_bus_that_lives_in_one_program_cannot_be_watched(small_cell, rig):
    name = small_cell.cell.arm[0].bus
    with pytest.raises(ConfigError, match="lives in one program alone.*give the command that moves --live"):
        watch(small_cell, {name: BusSpec.parse("virtual:x")}, rig.feed)


def test_a_recording_of_another_arm_gives_no_constants(small_cell, config, tmp_path):
    (tmp_path / "x.h5").write_text("no")
    with pytest.raises(InputError, match=r"x\.h5"):
        stored_constants(tmp_path / "x.h5", config)
