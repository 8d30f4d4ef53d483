"""From the cell file to the measured table, on simulated drives."""

import uuid
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from drives.bus import BusSpec
from drives.errors import NodeMissing, SeveralFailures
from gateway.acquire.events import PoseDone, Progress, VisitDone
from gateway.acquire.planning import make_plan
from gateway.acquire.session import plan_of_recording, record
from gateway.data.recording.reader import read
from gateway.errors import InputError
from gateway.model.arm_model import robot_text
from gateway.motion.opening import open_arm
from sim.serve import RunningSimulation, running

pytestmark = pytest.mark.xdist_group("session")

CELL = Path(__file__).parents[3] / "examples" / "small" / "cell.toml"


@pytest.fixture(scope="module")
def simulation():
    pytest.importorskip("pybullet")
    with running(CELL, bus=f"virtual:{uuid.uuid4()}", pacing="lockstep") as running_simulation:
        yield running_simulation


def override(simulation: RunningSimulation) -> BusSpec:
    return BusSpec.parse(simulation.bus)


@pytest.fixture(scope="module")
def plan(small_cell):
    loaded = small_cell.model_copy(
        update={
            "cell": small_cell.cell.model_copy(
                update={"poses": small_cell.cell.poses.model_copy(update={"validation": 0, "samples": 40})}
            )
        }
    )
    return make_plan(loaded, n_poses=2)


@pytest.fixture(scope="module")
def recorded(simulation, small_cell, plan, tmp_path_factory):
    """A run that Ctrl-C breaks in the middle, then gone on with; yields path, events and the summary."""
    path = tmp_path_factory.mktemp("session") / "run.h5"
    events: list = []

    def break_after_first_pose(event) -> None:
        if isinstance(event, PoseDone):
            raise KeyboardInterrupt

    with open_arm(small_cell, override(simulation)) as opened:
        with pytest.raises(KeyboardInterrupt):
            record(opened, plan, "none", path, None, (break_after_first_pose,))
        broken = read(path)
        summary = record(opened, plan, "none", path, broken, (events.append,))
        energised = any(axis.free for arm in simulation.simulation.arms for axis in arm.world.axes)
    return path, events, summary, broken, energised


@pytest.mark.slow
def test_a_broken_run_says_so(recorded):
    _, _, _, broken, _ = recorded
    assert broken.exit_status == "abort"
    assert len(broken.arms[0].visits) == 2
    assert len(broken.arms[0].missing("none")) == 2


def test_the_rest_is_measured_and_the_brakes_are_on(recorded, plan):
    path, events, summary, _, energised = recorded
    recording = read(path)
    assert not energised
    assert recording.exit_status == "success"
    assert recording.arms[0].missing("none") == ()
    assert (summary.visits, summary.skipped) == (2, 2)
    assert sum(isinstance(event, VisitDone) for event in events) == 2
    assert [event for event in events if isinstance(event, Progress)][-1].remaining_s == 0
    assert recording.arms[0].bus_statistics["incomplete"] == 0
    assert recording.arms[0].poses == plan.poses
    assert any(entry["index"] == 0x6060 for entry in recording.arms[0].ledger)


def test_half_sums_are_the_gravity_of_the_model(recorded, small_cell, simulation):
    """Pinocchio on the same file, not the gateway's model; what friction leaves is a small part of the band."""
    recording = read(recorded[0])
    model = pinocchio.buildModelFromXML(robot_text(small_cell, small_cell.cell.arm[0]))
    data = model.createData()
    second = [visit for visit in recording.arms[0].visits if visit.gravity_nm is not None]
    assert len(second) == 2
    for visit in second:
        expected = pinocchio.computeGeneralizedGravity(model, data, visit.q_rad.mean(axis=0))
        left = np.abs(visit.gravity_nm - expected)
        assert (visit.friction_band_nm > 0).all()
        assert (left < 0.25 * visit.friction_band_nm + 0.02 * np.abs(expected)).all()


def test_arm_stood_at_the_poses(recorded, plan):
    table = read(recorded[0]).table()
    for row in range(len(table)):
        pose = next(pose for pose in plan.poses if pose.number == table.pose[row])
        assert table.q_rad[row] == pytest.approx(pose.q_rad, abs=2e-3)
        assert (table.direction[row] == table.direction[row, 0]).all()


def test_plan_of_a_recording_has_its_poses(recorded, small_cell, plan):
    again = plan_of_recording(small_cell, read(recorded[0]))
    assert again.poses == plan.poses
    with pytest.raises(InputError, match="requests no poses"):
        plan_of_recording(small_cell, read(recorded[0]).__class__(**_without_arms(read(recorded[0]))))


def _without_arms(recording) -> dict:
    names = recording.__slots__
    return {name: getattr(recording, name) for name in names} | {"arms": ()}


def test_other_poses_under_the_same_numbers_are_refused(recorded, simulation, small_cell):
    other = make_plan(small_cell, n_poses=2, seed=99)
    with open_arm(small_cell, override(simulation)) as opened, pytest.raises(InputError, match="another posture"):
        record(opened, other, "none", recorded[0], read(recorded[0]))


def test_an_existing_file_is_refused_before_anything_moves(recorded, simulation, small_cell, plan):
    with open_arm(small_cell, override(simulation)) as opened:
        syncs = opened.group.sync_index
        with pytest.raises(InputError, match="--resume"):
            record(opened, plan, "none", recorded[0])
        assert opened.group.sync_index == syncs


@pytest.mark.slow
def test_a_whole_file_is_gone_on_with_without_power(recorded, simulation, small_cell, plan):
    visits = len(read(recorded[0]).arms[0].visits)
    with open_arm(small_cell, override(simulation)) as opened:
        syncs = opened.group.sync_index
        summary = record(opened, plan, "none", recorded[0], read(recorded[0]))
        assert opened.group.sync_index == syncs
    recording = read(recorded[0])
    assert (summary.visits, summary.skipped) == (0, 4)
    assert recording.exit_status == "success"
    assert len(recording.arms[0].visits) == visits


def test_no_drive_on_the_bus(small_cell):
    with (
        pytest.raises((NodeMissing, SeveralFailures), match="no device answers") as refused,
        open_arm(small_cell, BusSpec.parse(f"virtual:{uuid.uuid4()}")),
    ):
        pass
    assert refused.value.exit_code == 4
