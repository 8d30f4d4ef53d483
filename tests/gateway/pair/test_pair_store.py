"""What a pair keeps on disk, and what it belongs to."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.errors import InputError
from gateway.pair.controller import EMBODIMENTS, PairController
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import calibration_of
from gateway.pair.pair_run import PairCycle
from gateway.pair.pair_store import PairStore, cell_hash, line_of_grippers, run_result
from gateway.pair.session import PairLink
from gateway.pair.transform_function import constant_function, transform_of
from gateway.result.pair import LinkStatistics
from gateway.result.values import plain_values
from tests.gateway.pair.together import EXAMPLE


@pytest.fixture(scope="module")
def cell():
    return load_pair(EXAMPLE / "cell.toml")


@pytest.fixture(scope="module")
def distance_cell():
    return load_pair(EXAMPLE / "distance.toml")


@pytest.fixture
def store(cell, tmp_path) -> PairStore:
    return PairStore(cell, tmp_path / "cell.pair")


def changed(cell, arm: int, **fields):
    arms = list(cell.arms)
    arms[arm] = replace(arms[arm], **fields)
    return replace(cell, arms=tuple(arms))


def moved(pose: np.ndarray, by_m: float) -> np.ndarray:
    out = pose.copy()
    out[1, 3] += by_m
    return out


@pytest.mark.parametrize("arm", [0, 1])
def test_a_function_belongs_to_bases_grips_and_arms(cell, arm):
    """A tenth of a millimetre counts, a nanometre does not."""
    plain, one = cell_hash(cell), cell.arms[arm]
    assert cell_hash(load_pair(EXAMPLE / "cell.toml")) == plain
    for name in ("world_from_base", "part_from_tip"):
        assert cell_hash(changed(cell, arm, **{name: moved(getattr(one, name), 1e-4)})) != plain
        assert cell_hash(changed(cell, arm, **{name: moved(getattr(one, name), 1e-10)})) == plain
    for name in ("tool", "fixed", "step_m"):
        chain = replace(one.chain, **{name: getattr(one.chain, name) + 1e-4})
        assert cell_hash(changed(cell, arm, chain=chain)) != plain
    for axis in ({"zero_offset_rad": 0.1}, {"position_sign": -1}):
        axes = list(one.config.axis)
        axes[3] = axes[3].model_copy(update=axis)
        assert cell_hash(changed(cell, arm, config=one.config.model_copy(update={"axis": tuple(axes)}))) != plain


def test_a_function_belongs_to_its_distance_sensors(distance_cell):
    gap = distance_cell.gap
    channels = list(gap.config.channel)
    channels[0] = channels[0].model_copy(update={"gap_m": channels[0].gap_m + 1e-3})
    other = replace(gap, config=gap.config.model_copy(update={"channel": tuple(channels)}))
    assert cell_hash(replace(distance_cell, gap=other)) != cell_hash(distance_cell)
    slower = replace(gap, config=gap.config.model_copy(update={"missing_cycles": gap.config.missing_cycles + 1}))
    assert cell_hash(replace(distance_cell, gap=slower)) == cell_hash(distance_cell)


def test_learning_is_on_until_it_is_switched_off_and_forgetting_switches_it_on(cell, store):
    assert not store.frozen
    assert not store.forget()
    store.freeze(True)
    assert store.frozen
    store.freeze(False)
    assert not store.frozen
    store.freeze(True)
    for stage in ("second", "back"):
        store.freeze(True)
        store.save(stage, constant_function(cell.nominal_relation), learn_source="command", speed=1.0)
        assert store.load(stage) is not None
        assert store.forget()
        assert store.load(stage) is None
        assert not store.frozen


def test_a_function_for_another_path_or_cell_is_refused(cell, store):
    store.save("first", constant_function(cell.nominal_relation), learn_source="taught", speed=0.0)
    assert transform_of(store.load("first")).at(0.1) == pytest.approx(cell.nominal_relation)
    for name in ("path_hash", "cell_hash"):
        held = getattr(store, name)
        setattr(store, name, "0" * len(held))
        with pytest.raises(InputError, match="another"):
            store.load("first")
        setattr(store, name, held)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "state.json:1: not valid JSON"),
        ("[" * 9999, "state.json: contains .* nesting"),
        ("[]", "one JSON object is expected"),
    ],
)
def test_a_damaged_file_is_named(store, text, says):
    store.write("state.json", text)
    with pytest.raises(InputError, match=says):
        _ = store.frozen


def test_runs_without_a_cycle_are_left_out_of_the_report(store):
    run = {"name": "A", "text": "x", "speed": 1.0, "s_m": [0.0, 0.5], "x_m": [0.7, 0.9], "knots_s_m": []}
    run |= {"first_n": [0.0, 1.0], "last_n": [0.0, 2.0]}
    cycle = {"force_n": 60.0, "moment_nm": 9.0, "knots": 1}
    store.write("run-B.json", json.dumps(run | {"name": "B", "cycles": [cycle]}))
    store.write("run-A.json", json.dumps(run | {"cycles": []}))
    assert [body.name for body in store.runs()] == ["B"]
    store.write("run-A.json", json.dumps(run | {"cycles": [cycle]}))
    assert [body.name for body in store.runs()] == ["A", "B"]


def test_the_line_of_the_grippers_points_from_the_master_to_the_slave(cell):
    path = cell.path(2.0)
    along = line_of_grippers(cell, path)
    assert np.linalg.norm(along, axis=1) == pytest.approx(np.ones(len(path)))
    for row in (0, len(path) // 2):
        one = cell.arms[0].world_from_base @ path.commands[row]
        two = one @ cell.nominal_relation
        assert along[row] == pytest.approx((two[:3, 3] - one[:3, 3]) / np.linalg.norm(two[:3, 3] - one[:3, 3]))


STATISTICS = LinkStatistics("lockstep", (7, 7), (0, 0), (0, 0))


def run_of(cell, path, name):
    """A run of one row on a path, as far as the report takes it."""
    function = constant_function(cell.nominal_relation)
    controller = PairController(EMBODIMENTS[name], path, calibration_of(cell), function)
    return SimpleNamespace(path=path, config=EMBODIMENTS[name], controller=controller)


def summary(cell, path, force, gaps=None):
    controller = PairController(EMBODIMENTS["A"], path, calibration_of(cell), constant_function(cell.nominal_relation))
    controller.start_cycle()
    found = controller.end_cycle(complete=False)
    return PairCycle(found, force, np.zeros((len(path), 0)) if gaps is None else gaps, 0.0, 0.0)


def across(along: np.ndarray) -> np.ndarray:
    """Unit vectors (M, 3) square to the given ones."""
    out = np.cross(along, [0.0, 0.0, 1.0])
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def test_a_run_for_the_report_shows_force_along_the_line_of_the_first_and_the_last_cycle(cell):
    path = cell.path(2.0)
    along = line_of_grippers(cell, path)
    force = np.zeros((len(path), 6))
    force[:, :3] = 12.345 * along + 5.0 * across(along)
    cycles = [summary(cell, path, force), summary(cell, path, 7 * force), summary(cell, path, -2 * force)]
    body = run_result(cell, run_of(cell, path, "A"), cycles, STATISTICS)
    assert body.first_n == pytest.approx([12.345] * len(path), abs=0.006)
    assert set(body.last_n) == {-24.69}
    assert body.first_size_n == pytest.approx([np.hypot(12.345, 5.0)] * len(path), abs=0.006)
    assert body.last_size_n == pytest.approx([2 * np.hypot(12.345, 5.0)] * len(path), abs=0.006)
    assert body.x_m[0] == pytest.approx((cell.arms[0].world_from_base @ path.commands[0])[0, 3])
    assert (body.speed, len(body.cycles)) == (2.0, 3)
    assert np.isnan(body.cycles[0].force_n)
    assert plain_values(body)["cycles"][0]["force_n"] is None


def test_a_gap_for_the_report_is_the_worst_of_its_sensors_with_its_sign(distance_cell):
    path = distance_cell.path(2.0)
    count = len(distance_cell.gap.config.channel)
    gaps = np.zeros((len(path), count))
    gaps[3, :2] = (1e-4, -3e-4)
    gaps[4, 0] = 2e-4
    gaps[5] = np.nan
    cycle = summary(distance_cell, path, np.zeros((len(path), 6)), gaps)
    body = run_result(distance_cell, run_of(distance_cell, path, "A"), [cycle, cycle], STATISTICS)
    assert body.first_m[2:5] == (0.0, -3e-4, 2e-4)
    assert np.isnan(body.first_m[5])
    assert "first_n" not in plain_values(body)


def test_statistics_of_both_buses_by_the_clock():
    counts = SimpleNamespace(cycles=100, incomplete=1, late=2)
    opened = tuple(SimpleNamespace(group=SimpleNamespace(statistics=counts)) for _ in range(2))
    skew = [1e-4] * 98 + [-3e-4, 5e-4]
    link = PairLink(opened, SimpleNamespace(real=True, skew_s=skew))  # type: ignore[arg-type]
    found = link.statistics()
    assert (found.pacing, found.cycles) == ("real", (100, 100))
    assert found.skew_s.median == pytest.approx(1e-4)
    assert found.skew_s.max == pytest.approx(5e-4)
    assert 3e-4 <= found.skew_s.p99 <= 5e-4
