"""A load measured until it is known: the run drives what is decided, keeps the limits, and ends in its brakes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drives.errors import DriveFault
from gateway.acquire.events import Narrowed, PoseDone, Progress, StateChanged
from gateway.acquire.plan import VisitSettings
from gateway.acquire.poses import DISTANCE_RAD, feasible_postures
from gateway.acquire.run_loop import Run
from gateway.acquire.until import POOL, LoadSearch, NextStep, chosen_poses, decide
from gateway.acquire.until_goal import LEAST_POSES, Goal, ended, half_widths, narrowed
from gateway.acquire.visit_store import MemoryStore
from gateway.cell.conversion import AxisConversion
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.identify.knowledge import Knowledge
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor
from gateway.motion.arm import Arm
from tests.gateway.conftest import BAND_NM, FakeDrives

pytestmark = pytest.mark.xdist_group("until")

TRUTH = np.array([6.0, 0.12, 0.06, 0.6])
SETTINGS = VisitSettings(
    approach_offset_rad=0.03, approach_speed_rad_s=0.2, settle_timeout_s=2.0, samples=40, period_s=0.01
)
FINE = Goal(mass_share=0.02, com_m=0.005)


@pytest.fixture(scope="module")
def search(small_cell, workspace) -> LoadSearch:
    offset_rad, random = SETTINGS.approach_offset_rad, np.random.default_rng(3)
    gravity_m_s2 = tuple(workspace.gravity_m_s2.tolist())
    options = Knowledge(link_std=0.0, gain_std=(0.0,) * 6, gravity_m_s2=gravity_m_s2)
    return LoadSearch(
        "main",
        "a",
        FINE,
        workspace.robot,
        options,
        workspace,
        SETTINGS,
        pool_rad=feasible_postures(workspace.with_clearance(), 4, offset_rad, random)[:POOL],
        earlier=None,
        apart_rad=np.empty((0, 6)),
        number=7,
        seed=3,
        torque_scale=np.ones(6),
    )


def fake_arm(small_cell, workspace) -> tuple[FakeDrives, Arm]:
    """An arm that carries the links of the model and a load, through gears without losses."""
    held: dict[bytes, np.ndarray] = {}

    def gravity(q_rad):
        key = q_rad.tobytes()
        if key not in held:
            rows = gravity_regressor(workspace.robot, q_rad[None], workspace.gravity_m_s2)[0]
            held[key] = rows @ workspace.links + rows[:, LOAD_COLUMNS] @ TRUTH
        return held[key]

    axes = replace(AxisConversion.from_arm(small_cell.cell.arm[0]), efficiency=np.ones(6))
    drives = FakeDrives(axes, gravity, BAND_NM, noise_nm=0.2)
    return drives, Arm("main", drives, axes)


@pytest.fixture(scope="module")
def rows(small_cell):
    def table(visits):
        arm = ArmRecording("main", (), tuple(visits), (), [], [], {})
        return Recording(small_cell.folder, "", "", "", "", small_cell.cell, "", "", {}, (arm,)).table("main")

    return table


def _end(decision: NextStep) -> str:
    return ended(decision.stock, decision.verdict, "a")


def measure(run: Run, arm: Arm, search: LoadSearch, rows) -> NextStep:
    """Measure until the load is known; the last decision."""
    decisions = []
    assert run.execute(chosen_poses(search, rows, arm.where(), decisions), "a") == _end(decisions[-1])
    return decisions[-1]


@pytest.fixture(scope="module")
def finished(small_cell, workspace, search, rows) -> SimpleNamespace:
    """One run to its end."""
    drives, arm = fake_arm(small_cell, workspace)
    events, store = [], MemoryStore()
    decision = measure(Run(arm, workspace, store, (events.append,)), arm, search, rows)
    return SimpleNamespace(drives=drives, events=events, store=store, decision=decision)


@pytest.mark.slow
def test_the_run_ends_once_the_load_is_known(finished, workspace):
    decision, events = finished.decision, finished.events
    load = decision.stock.load
    assert decision.plan is None
    assert decision.verdict.reached.all()
    assert load.mass_kg == pytest.approx(TRUTH[0], abs=3 * load.mass_std_kg + 1e-3)
    assert load.com_m == pytest.approx(TRUTH[1:] / TRUTH[0], abs=3 * load.com_std_m.max() + 1e-4)
    assert (half_widths(load) <= FINE.half_widths(load.mass_kg)).all()
    assert finished.drives.log == ["enable", "disable"]
    assert workspace.feasible(np.unique(finished.drives.path, axis=0)).all()
    numbers = [visit.pose for visit in finished.store.visits]
    assert numbers == [number for number in range(7, 7 + decision.verdict.poses) for _ in range(2)]
    narrowings = [event for event in events if isinstance(event, Narrowed)]
    assert [event.poses for event in narrowings] == list(range(1, decision.verdict.poses + 1))
    assert "has reached the requested uncertainty" in _end(decision)
    assert [event.pose for event in events if isinstance(event, PoseDone)] == numbers[::2]
    assert [event.remaining_s for event in events if isinstance(event, Progress)][-1] == 0.0
    assert [str(event.state.phase) for event in events if isinstance(event, StateChanged)][-1] == "in its brakes"


def test_poses_keep_a_distance_and_what_the_band_hides_is_sampled_shortly(finished):
    q_rad = np.array([visit.target_rad for visit in finished.store.visits[::2]])
    assert len(q_rad) >= LEAST_POSES
    apart = np.abs(q_rad[:, None] - q_rad[None]).max(axis=2) + np.eye(len(q_rad))
    assert apart.min() >= DISTANCE_RAD
    assert {len(visit) for visit in finished.store.visits} <= set(range(20, 41))


def test_a_load_that_is_known_is_not_measured_again(finished, small_cell, workspace, search, rows):
    drives, arm = fake_arm(small_cell, workspace)
    known = replace(search, earlier=rows(finished.store.visits), number=50)
    again = measure(Run(arm, workspace, MemoryStore()), arm, known, rows)
    assert again.plan is None
    assert drives.log == []


def test_the_same_visits_lead_to_the_same_decision(finished, search, rows):
    some = rows(finished.store.visits[:4])
    at_rad = finished.store.visits[3].target_rad
    one, other = (decide(search, some, at_rad) for _ in range(2))
    assert one.plan == other.plan
    assert one.plan.poses[0].number == 9
    assert "2 poses: mass " in narrowed(one.verdict, ends=False)


def test_a_fault_during_a_transfer_ends_it_in_the_brakes_and_keeps_the_visits(small_cell, workspace, search, rows):
    drives, arm = fake_arm(small_cell, workspace)
    drives.fault_at = 500
    store = MemoryStore()
    with pytest.raises(DriveFault):
        measure(Run(arm, workspace, store), arm, search, rows)
    assert drives.log[0] == "enable"
    assert drives.log[-1] == "disable"
    assert store.visits
