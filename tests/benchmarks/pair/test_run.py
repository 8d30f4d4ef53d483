"""The pair over two buses: short paths, faults of one arm, the force limit, teaching that is resumed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.pair.bus_rig import NO_LIMIT_N, PairRig, pair_rig
from drives.errors import DriveError
from gateway.errors import PlanRefused
from gateway.motion.power import powered
from gateway.pair.controller import EMBODIMENTS, with_gains
from gateway.pair.pair_motion import PairMotion, PairMotionOptions, PairStopped, refuse_elsewhere
from gateway.pair.pair_run import PairRun
from gateway.pair.session import cell_gains
from gateway.pair.teach import TaughtPath, Teacher, TeachRule, taught_path_from_json
from gateway.pair.transform_function import constant_function
from sim.fake_drive import FakeDrive
from sim.states import PdsState

FAST = 3.0


def row(rig: PairRig, name: str, **options: object) -> PairRun:
    """A row of the table at the start of the path, gripped."""
    options_ = PairMotionOptions(**{"speed": FAST, "force_limit_n": NO_LIMIT_N, **options})  # type: ignore[arg-type]
    config = with_gains(EMBODIMENTS[name], cell_gains(rig.cell))
    return rig.run(config, constant_function(rig.cell.nominal_relation), options_)


def drives(rig: PairRig) -> list[FakeDrive]:
    """All twelve."""
    return [drive for unit in rig.simulation.arms for drive in unit.drives]


@pytest.mark.slow
def test_one_cycle_with_twelve_drives() -> None:
    with pair_rig(0) as rig:
        run = row(rig, "C2c")
        done, record = rig.cycle(run)
        assert done.summary.learned == done.summary.complete
        statistics = rig.link.statistics()
        q = np.concatenate([sample.q_rad for sample in run.motion.samples or ()])
        wanted = np.concatenate(run.motion.q_rad)
        true = np.linalg.norm(record[:, 1:4], axis=1)
        rig.power.off()
    assert sum(statistics.incomplete) <= 2
    assert np.abs(q - wanted).max() < 0.02
    assert 20.0 < true.max() < 400.0
    assert abs(done.summary.force_n - true.max()) < 0.5 * true.max()


@pytest.mark.slow
def test_a_pair_without_errors_feels_next_to_nothing() -> None:
    with pair_rig(None) as rig:
        _, record = rig.cycle(row(rig, "A", speed=1.0))
        rig.power.off()
    # what is left: gears wound up by gravity and acceleration, friction at reversals
    assert np.linalg.norm(record[:, 1:4], axis=1).max() < 90.0


def stops_responding(drive: FakeDrive) -> None:
    drive.node.unpowered = True


def has_a_fault(drive: FakeDrive) -> None:
    drive.raise_fault(0x3210)


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "harm"), [(0, has_a_fault), (1, stops_responding)])
def test_one_arm_fails_and_both_stop(arm: int, harm: Callable[[FakeDrive], None]) -> None:
    with pair_rig(0) as rig:
        run = row(rig, "B", speed=1.5)
        seen: list[tuple[float, int, int, float]] = []

        def note(time_s: float) -> None:
            states = [drive.automaton.state is PdsState.OPERATION_ENABLED for drive in drives(rig)]
            force = float(np.linalg.norm(rig.world.wrench[:3]))
            seen.append((time_s, sum(states[:6]), sum(states[6:]), force))

        rig.world.after.append(note)
        began_s = rig.world.time_s

        def break_later(time_s: float) -> None:
            if time_s > began_s + 1.3 and break_later in rig.world.after:
                rig.world.after.remove(break_later)
                harm(drives(rig)[6 * arm + 2])

        rig.world.after.append(break_later)
        with pytest.raises(DriveError):
            rig.power.attempt(run.cycle)
        assert not rig.link.together.enabled
        assert run.controller.state().second is None
        assert all(
            drive.automaton.state is not PdsState.OPERATION_ENABLED for drive in drives(rig) if not drive.node.unpowered
        )
        ends = [
            next(time_s for time_s, *left, _ in seen if left[index] < 6 and time_s > began_s + 1.3) for index in (0, 1)
        ]
        period = rig.cell.sync_period_s
        # a fault is answered at once; missing answers count after five SYNCs; the drive keeps its last target
        latest_s = ends[arm] + 3 * period if harm is has_a_fault else began_s + 1.3 + 9 * period
        assert ends[1 - arm] < latest_s
        assert max(force for *_, force in seen) < 1500.0
        drives(rig)[6 * arm + 2].node.unpowered = False


@pytest.mark.slow
def test_a_force_above_twice_the_limit_stops_both_at_once() -> None:
    with pair_rig(0) as rig:
        run = row(rig, "A", force_limit_n=None, speed=1.5)
        left: list[tuple[float, int]] = []
        rig.world.after.append(
            lambda time_s: left.append(
                (time_s, sum(drive.automaton.state is PdsState.OPERATION_ENABLED for drive in drives(rig)))
            )
        )
        with pytest.raises(PairStopped, match="above 80 N for more than 20 ms"):
            rig.power.attempt(run.cycle)
        moving = [count for _, count in left]
        assert moving[-1] == 0
        assert sum(0 < count < 12 for count in moving[moving.index(12) :]) <= 3
        assert np.linalg.norm(rig.world.wrench[:3]) < 1500.0


def test_an_arm_at_another_posture_is_refused() -> None:
    with pair_rig(None) as rig:
        rig.world.motors.theta[2] += 0.1
        rig.world.motors.show()
        with pytest.raises(PlanRefused, match="joint 3 is at"):
            refuse_elsewhere(rig.cell, rig.link.together.where())
        assert all(drive.automaton.state is not PdsState.OPERATION_ENABLED for drive in drives(rig))


@pytest.mark.slow
def test_teaching_goes_on_where_it_ended() -> None:
    rule = TeachRule(force_n=40.0, moment_nm=10.0, sweep_s=0.2, path_speed_m_s=0.6)
    with pair_rig(0) as rig:
        indices = rig.cell.path(1.0).uniform(2)
        taught, saved = TaughtPath("path", "cell"), []
        for count in (1, 2):
            options = PairMotionOptions(force_limit_n=NO_LIMIT_N)
            stream = rig.link.stream(rig.cell, options.moves)
            teacher = Teacher(PairMotion(rig.cell, stream, options), cell_gains(rig.cell), rule)
            with powered(stream):
                teacher.run(taught, indices[:count], lambda _taught, point: saved.append(point.command - 1))
            taught = taught_path_from_json(taught.to_json(), "points.json")
    assert saved == indices.tolist()
    assert len(taught.function(np.eye(4))) == 2
    assert all(point.force_n[-1] <= 40.0 for point in taught.points)
