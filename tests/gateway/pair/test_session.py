"""A pair taught and run from its files to its files, on two arms without a bus and a part that is a spring."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drives.errors import DriveFault
from gateway.errors import ConfigError, InputError, PlanRefused
from gateway.motion.power import powered
from gateway.motion.stops import StopDesk, StoppedByPerson
from gateway.motion.stream import MoveOptions
from gateway.pair.balance import ForceBalance
from gateway.pair.controller import DISTANCE_GAINS, EMBODIMENTS
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import PairMotion, PairMotionOptions, PairStopped, refuse_elsewhere
from gateway.pair.pair_run import PairRun
from gateway.pair.pair_store import PairStore
from gateway.pair.servo_lag import equalised_targets
from gateway.pair.session import (
    cell_gains,
    embodiment_of,
    first_function,
    function_back,
    one_relation,
    open_taught_path,
    run_pair,
    servo_laws,
    speed_table,
    teach_pair,
)
from gateway.pair.teach import TaughtPath, Teacher, TeachRule
from gateway.pair.transform import correction_between
from gateway.pair.transform_function import constant_function, transform_of
from gateway.result.pair import LinkStatistics
from gateway.result.values import plain_values
from tests.gateway.pair.together import EXAMPLE, Together

#: How far the grasps are off [m, rad].
AWAY = np.array([3.2e-4, -2.0e-4, 2.4e-4, 6.0e-4, -4.0e-4, 3.2e-4])
SPEED = 2.0
#: At which a cycle is so well repeated that what one has learned shows in the next.
LEARNING_SPEED = 1.0


@pytest.fixture
def pair() -> Iterator[Together]:
    pair = Together(AWAY)
    yield pair
    pair.arms.close()


@pytest.fixture
def store(pair, tmp_path) -> PairStore:
    return PairStore(pair.cell, tmp_path / "cell.pair")


def options(**changes) -> PairMotionOptions:
    return PairMotionOptions(**{"speed": SPEED, "force_limit_n": 1e4, **changes})


def run(pair, store, name: str, cycles: int = 1, **changes):
    events = []
    body = run_pair(
        pair.link, pair.cell, store, embodiment_of(pair.cell, name), cycles, events.append, options(**changes)
    )
    return body, events


# -- teaching ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def taught(tmp_path_factory):
    """A pair whose path was taught at its two ends: the store, the events, the function, the pair."""
    pair = Together(3 * AWAY)
    store = PairStore(pair.cell, tmp_path_factory.mktemp("taught"))
    events = []
    taught_path = open_taught_path(pair.cell, store, resume=False)
    function = teach_pair(pair.link, pair.cell, store, taught_path, lambda *words: events.append(words), options())
    yield store, events, function, pair
    pair.arms.close()


@pytest.mark.slow
def test_teaching_finds_the_relation_that_the_part_has_whatever_the_cell_says(taught):
    """What is left is what the set value, 5 N and 1.5 Nm, is on the stiffness of this part, and friction's rest."""
    store, events, function, pair = taught
    assert [(number, of) for _, number, of in events] == [(1, 2), (2, 2)]
    begun = correction_between(pair.cell.nominal_relation, pair.true)
    for s_m in (0.0, float(function.s_m[-1])):
        left = correction_between(function.at(s_m), pair.true)
        assert np.linalg.norm(left[:3]) < 0.3 * np.linalg.norm(begun[:3])
    assert len(events[0][0].force_n) > 1
    for point, _, _ in events:
        assert point.force_n[-1] <= 5.0
        assert point.moment_nm[-1] <= 1.5
        assert len(point.force_n) == len(point.moment_nm)
        assert all(n > 5.0 or nm > 1.5 for n, nm in zip(point.force_n[:-1], point.moment_nm[:-1], strict=True))
    assert [drives.log for drives in pair.drives] == [["enable", "disable"]] * 2
    for index, arm in enumerate(pair.cell.arms):
        assert pair.part.q_rad[index] == pytest.approx(arm.start_rad, abs=5e-3)


@pytest.mark.slow
def test_what_was_taught_is_on_disk(taught):
    store, events, function, pair = taught
    stored = store.load("first")
    assert stored is not None
    assert (stored.learn_source, stored.speed, stored.embodiment) == ("taught", 0.0, "C1")
    assert transform_of(stored).at(0.01) == pytest.approx(function.at(0.01))
    again = open_taught_path(pair.cell, store, resume=True)
    assert [point.command for point in again.points] == [point.command for point, _, _ in events]
    with pytest.raises(InputError, match="holds taught points.*--resume"):
        open_taught_path(pair.cell, store, resume=False)


def test_points_that_are_taught_are_not_taught_again(taught, pair, store):
    points = [point for point, _, _ in taught[1]]
    taught_path = TaughtPath(store.path_hash, store.cell_hash, list(points))
    events = []
    teach_pair(pair.link, pair.cell, store, taught_path, lambda *words: events.append(words), options())
    assert events == []
    assert taught_path.points == points


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "says"),
    [
        (TeachRule(sweep_s=0.5, largest_m=3e-4), r"point 1: the adjustment went 0\.\d mm .* check bases, grasps"),
        (TeachRule(sweep_s=0.5, largest_rad=2e-4), r"point 1: the adjustment went .* mrad away"),
        (TeachRule(sweep_s=0.5, rounds=2, force_n=1e-6), r"point 1: \d+\.\d N and .* are left after 2 sweeps"),
    ],
)
def test_a_point_that_cannot_be_adjusted_stops_both(pair, store, rule, says):
    stream = pair.link.stream(pair.cell, MoveOptions())
    teacher = Teacher(PairMotion(pair.cell, stream, options()), cell_gains(pair.cell), rule)
    taught_path = open_taught_path(pair.cell, store, resume=False)
    with pytest.raises(PairStopped, match=says), powered(stream):
        teacher.run(taught_path, np.array([0]), lambda *_: None)
    assert taught_path.points == []
    assert [drives.log for drives in pair.drives] == [["enable", "disable"]] * 2


# -- running -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_goes_there_and_back_as_often_as_asked_and_is_stored_for_the_report(pair, store):
    store.save("first", constant_function(pair.true), learn_source="taught", speed=0.0)
    body, events = run(pair, store, "C1", cycles=2)
    assert len(events) == len(body.cycles) == 2
    assert body.name == "C1"
    assert body.speed == SPEED
    assert len(body.s_m) == len(body.x_m) == len(body.first_n) == len(pair.cell.path(SPEED))
    assert body.statistics == LinkStatistics("lockstep", (7, 7), (1, 1), (2, 2))
    assert body.evaluation_s > 0.0
    assert [plain_values(kept) for kept in store.runs()] == [plain_values(body)]
    assert [drives.log for drives in pair.drives] == [["enable", "disable"]] * 2
    for drives, arm in zip(pair.drives, pair.cell.arms, strict=True):
        assert pair.part.q_rad[drives.index] == pytest.approx(arm.start_rad, abs=5e-3)


@pytest.mark.slow
def test_a_function_that_fits_the_part_leaves_little_force_and_the_grasps_alone_much(pair, store):
    """By the spring alone the grasps' error is worth half the cell's stiffness times 0.45 mm."""
    store.save("first", constant_function(pair.true), learn_source="taught", speed=0.0)
    good = run(pair, store, "C1")[0].cycles[0].force_n
    bad = run(pair, store, "A")[0].cycles[0].force_n
    spring_n = 0.5 * pair.cell.config.force.stiffness.straight * np.linalg.norm(AWAY[:3])
    assert bad == pytest.approx(spring_n, rel=0.35)
    assert good < 0.6 * bad


@pytest.mark.slow
@pytest.mark.parametrize("frozen", [False, True])
def test_what_was_learned_is_kept_and_gone_on_from_unless_learning_is_off(pair, store, frozen):
    store.save("first", constant_function(pair.cell.nominal_relation), learn_source="taught", speed=0.0)
    store.freeze(frozen)
    body, events = run(pair, store, "C2c", cycles=2, speed=LEARNING_SPEED)
    second = store.load("second")
    assert (second is None) == frozen
    assert (store.folder / f"speed-{LEARNING_SPEED:g}.json").exists() != frozen
    assert any(cycle.summary.learned for cycle in events) != frozen
    if frozen:
        assert body.cycles[1].force_n == pytest.approx(body.cycles[0].force_n, rel=0.03)
        return
    assert (second.embodiment, second.speed, second.cycles) == ("C2c", LEARNING_SPEED, 2)
    assert body.cycles[1].force_n < body.cycles[0].force_n
    row = embodiment_of(pair.cell, "C2c")
    begun, where = first_function(pair.cell, store, row, LEARNING_SPEED)
    assert begun.knots == pytest.approx(transform_of(second).knots)
    assert where == f"learned by C2c {second.date}"


@pytest.mark.slow
def test_a_run_goes_back_by_what_the_run_before_has_learned_of_the_path_back(pair, store, monkeypatch):
    store.save("first", constant_function(pair.cell.nominal_relation), learn_source="taught", speed=0.0)
    row = embodiment_of(pair.cell, "C2c")
    assert function_back(store, row) is None
    run(pair, store, "C2c", cycles=2)
    kept = store.load("back")
    assert (kept.learn_source, kept.speed, kept.embodiment, kept.cycles) == ("command", SPEED, "C2c", 2)
    assert function_back(store, row).knots == pytest.approx(transform_of(kept).knots)
    begun = []
    monkeypatch.setattr(
        "gateway.pair.session.PairRun", lambda *changes: (begun.append(changes[5]), PairRun(*changes))[1]
    )
    run(pair, store, "C2c")
    assert begun[0].knots == pytest.approx(transform_of(kept).knots)
    store.freeze(True)
    before = (store.folder / "back.json").stat().st_mtime_ns
    run(pair, store, "C2c")
    assert (store.folder / "back.json").stat().st_mtime_ns == before
    assert function_back(store, embodiment_of(pair.cell, "C8")) is None
    assert function_back(store, embodiment_of(pair.cell, "B")) is None


def test_a_part_that_is_gripped_elsewhere_stops_both_before_the_path_begins(pair, store):
    with pytest.raises(PairStopped, match=r"during the approach to the start, above 2\.5 N: .* check the grasp"):
        run(pair, store, "A", force_limit_n=5.0)
    assert [drives.log for drives in pair.drives] == [["enable", "disable"]] * 2
    assert not (store.folder / "run-A.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("failing", [0, 1])
def test_a_fault_of_one_arm_ends_the_run_and_what_was_run_is_kept(pair, store, failing):
    pair.drives[failing].fault_at = 1500
    with pytest.raises(DriveFault):
        run(pair, store, "A", cycles=9)
    assert pair.drives[1 - failing].log[:2] == ["enable", "quick stop"]
    assert [drives.log[-1] for drives in pair.drives] == ["disable"] * 2
    kept = json.loads((store.folder / "run-A.json").read_text())
    assert 1 <= len(kept["cycles"]) < 9


@pytest.mark.slow
def test_a_stop_request_ends_a_run(pair, store):
    desk = StopDesk()

    def events(_cycle):
        desk.ask(StoppedByPerson("enough"))

    row = embodiment_of(pair.cell, "A")
    with pytest.raises(StoppedByPerson, match="enough"):
        run_pair(pair.link, pair.cell, store, row, 5, events, options(moves=MoveOptions(desk=desk)))
    assert len(json.loads((store.folder / "run-A.json").read_text())["cycles"]) == 1


@pytest.mark.slow
def test_a_sample_that_is_lost_spoils_the_cycle_for_learning(pair, store):
    store.save("first", constant_function(pair.cell.nominal_relation), learn_source="taught", speed=0.0)
    pair.drives[0].unanswered = {320}
    _, events = run(pair, store, "C2c")
    assert not events[0].summary.complete
    assert not events[0].summary.learned
    assert "incomplete" in events[0].summary.reason
    assert store.load("second") is None


@pytest.mark.slow
def test_a_slow_share_is_planned_slower(pair, store):
    body, _ = run(pair, store, "A", moves=MoveOptions(override=0.5))
    assert body.speed == 0.5 * SPEED


def test_arms_that_stand_elsewhere_are_not_moved(pair, store):
    pair.part.q_rad[1] = pair.part.q_rad[1] + np.array([0, 0, 0.021, 0, 0, 0])
    with pytest.raises(PlanRefused, match="joint 3 is at .* the part is gripped at"):
        run(pair, store, "A")
    assert [drives.log for drives in pair.drives] == [[], []]
    refuse_elsewhere(pair.cell, [arm.start_rad + 0.019 for arm in pair.cell.arms])


# -- rows of the table -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def distance_cell():
    return load_pair(EXAMPLE / "distance.toml", pacing="lockstep")


def test_gains_are_those_of_the_cell(pair, distance_cell):
    force = pair.cell.config.force
    assert cell_gains(pair.cell).damping == (force.damping.straight, force.damping.turned)
    spring = (0.0, 0.0) if force.spring is None else (force.spring.straight, force.spring.turned)
    assert cell_gains(pair.cell).stiffness == spring
    assert embodiment_of(pair.cell, "B").gains == cell_gains(pair.cell)
    changes = distance_cell.config.distance.damping_s
    expected = DISTANCE_GAINS.damping if changes is None else (changes.straight, changes.turned)
    assert cell_gains(distance_cell).damping == expected


def test_a_row_belongs_to_a_cell_that_feels_as_it_does(pair, distance_cell):
    with pytest.raises(ConfigError, match="cannot be run in a cell; choose one of"):
        embodiment_of(pair.cell, "O")
    by_distance = next(name for name, row in EMBODIMENTS.items() if row.sensing == "distance")
    with pytest.raises(ConfigError, match=r"has none; declare them in \[pair\.distance\]"):
        embodiment_of(pair.cell, by_distance)
    with pytest.raises(ConfigError, match=r"keep a gap .*choose E5"):
        embodiment_of(distance_cell, "C8")
    assert embodiment_of(distance_cell, by_distance).sensing == "distance"
    assert embodiment_of(distance_cell, "A").sensing == "distance"
    assert embodiment_of(pair.cell, "A").sensing == EMBODIMENTS["A"].sensing


def test_there_is_nothing_to_teach_where_a_gap_is_kept(distance_cell, tmp_path):
    with pytest.raises(ConfigError, match="no common part to be taught by force"):
        open_taught_path(distance_cell, PairStore(distance_cell, tmp_path), resume=False)


def test_a_run_begins_with_what_its_row_says(pair, store):
    rows = {name: embodiment_of(pair.cell, name) for name in ("A", "C1", "C8")}
    assert first_function(pair.cell, store, rows["A"], SPEED)[1] == "one relation, from the start"
    assert first_function(pair.cell, store, rows["A"], SPEED)[0].at(0.1) == pytest.approx(pair.cell.nominal_relation)
    with pytest.raises(InputError, match="run teach"):
        first_function(pair.cell, store, rows["C1"], SPEED)
    store.save("first", constant_function(pair.true), learn_source="taught", speed=0.0)
    taught, where = first_function(pair.cell, store, rows["C1"], SPEED)
    assert where.startswith("taught ")
    assert taught.at(0.1) == pytest.approx(pair.true)
    other = constant_function(pair.cell.nominal_relation)
    store.save("second", other, learn_source="command", speed=1.0, embodiment="C3", cycles=2)
    assert first_function(pair.cell, store, rows["C8"], SPEED)[1].startswith("taught ")
    store.save("second", other, learn_source="command", speed=1.0, embodiment="C8", cycles=2)
    assert first_function(pair.cell, store, rows["C8"], SPEED)[1].startswith("learned by C8 ")
    assert first_function(pair.cell, store, rows["C1"], SPEED)[1].startswith("taught ")


def test_rows_that_begin_with_what_was_taught_know_how_the_servos_follow(pair, store):
    rows = {name: embodiment_of(pair.cell, name) for name in ("B", "C8")}
    assert servo_laws(pair.cell, store, rows["C8"]) is None
    laws = np.tile((0.016, 0.08), (12, 1))
    taught_path = TaughtPath(store.path_hash, store.cell_hash, laws_s=laws)
    store.write("points.json", taught_path.to_json())
    assert servo_laws(pair.cell, store, rows["B"]) is None
    assert np.array_equal(servo_laws(pair.cell, store, rows["C8"]), laws)
    store.write("points.json", replace(taught_path, laws_s=laws[:7]).to_json())
    with pytest.raises(InputError, match="servo_law_s has 7 entries for 12 joints; teach again"):
        servo_laws(pair.cell, store, rows["C8"])


def test_one_relation_has_the_learning_points_of_a_row_that_learns(pair, distance_cell):
    plain = one_relation(pair.cell, embodiment_of(pair.cell, "A"), SPEED)
    assert len(plain) == 1
    row = embodiment_of(distance_cell, "E5")
    found = one_relation(distance_cell, row, SPEED)
    path = distance_cell.path(SPEED)
    assert found.s_m == pytest.approx(np.unique(path.s_m[path.in_time(row.points)]))
    assert found.at(0.3) == pytest.approx(distance_cell.nominal_relation)


def test_speeds_that_were_learned_lie_between_rest_and_the_fastest(pair, store):
    """Halfway between a stored speed and rest a function is midway between both."""
    first = constant_function(pair.cell.nominal_relation)
    store.save("first", first, learn_source="taught", speed=0.0)
    path = store.save("second", constant_function(pair.true), learn_source="command", speed=2.0, embodiment="C8")
    store.write("speed-2.json", path.read_text(encoding="utf-8"))
    table = speed_table(store, first)
    assert table.at(2.0).at(0.2) == pytest.approx(pair.true)
    assert table.at(0.0).at(0.2) == pytest.approx(pair.cell.nominal_relation)
    half = correction_between(table.at(1.0).at(0.2), pair.cell.nominal_relation)
    correction = correction_between(pair.true, pair.cell.nominal_relation)
    assert half == pytest.approx(correction / 2, rel=0.02, abs=1e-6)


@pytest.mark.slow
def test_what_takes_longer_than_a_sync_is_computed_while_both_arms_stand(pair, store, monkeypatch):
    """Model of the arms over a whole path, with each joint sent 10 ms ahead."""
    preparing, computed = [False], []
    plain = PairMotion.prepare

    def prepare(motion, job):
        preparing[0] = True
        try:
            return plain(motion, job)
        finally:
            preparing[0] = False

    def noted(name, heavy):
        return lambda *changes: (computed.append((name, preparing[0])), heavy(*changes))[1]

    row = replace(EMBODIMENTS["C2c"], gains=cell_gains(pair.cell))
    stream = pair.link.stream(pair.cell, MoveOptions())
    going = PairRun(pair.cell, stream, row, constant_function(pair.cell.nominal_relation), options())
    monkeypatch.setattr(PairMotion, "prepare", prepare)
    monkeypatch.setattr("gateway.pair.pair_setpoints.equalised_targets", noted("ahead", equalised_targets))
    monkeypatch.setattr(ForceBalance, "begin", noted("begin", ForceBalance.begin))
    with powered(stream):
        going.start()
        going.cycle()
        going.back()
    assert {name for name, _ in computed} == {"ahead", "begin"}
    assert all(at_rest for _, at_rest in computed)


@pytest.mark.slow
def test_the_path_back_learns_for_itself_unless_learning_is_off(pair, store):
    """Both directions have the same part between the hands; what one learns does not come from the other."""
    row = replace(EMBODIMENTS["C2c"], gains=cell_gains(pair.cell))
    most = {}
    for frozen in (False, True):
        stream = pair.link.stream(pair.cell, MoveOptions())
        going = PairRun(pair.cell, stream, row, constant_function(pair.cell.nominal_relation), options())
        with powered(stream):
            going.start()
            if frozen:
                going.controller.freeze()
            learned = [(going.cycle(), going.back())[1] for _ in range(4)]
        assert any(learned) != frozen
        assert (going.learned_back is None) == frozen
        back = going.learned_back or constant_function(pair.cell.nominal_relation)
        most[frozen] = np.linalg.norm(correction_between(back.at(0.0), pair.true)[:3])
    assert most[False] < 0.8 * most[True]
