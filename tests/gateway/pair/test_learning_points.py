"""Choice of learning points: every feature, the separation, union and pruning."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.pair.learning_points import Feature, Record, Selection, prune, refine, score, select
from gateway.pair.path import PairPath
from gateway.pair.transform_function import function_of_knots

COUNT = 126


def bump(at: int, height: float, width: float = 4.0) -> np.ndarray:
    return height * np.exp(-0.5 * ((np.arange(COUNT) - at) / width) ** 2)


def record(force: np.ndarray | None = None, correction: np.ndarray | None = None) -> Record:
    zero = np.zeros((COUNT, 6))
    return Record(zero if force is None else force, zero if correction is None else correction, zero)


def column(index: int, values: np.ndarray) -> np.ndarray:
    result = np.zeros((COUNT, 6))
    result[:, index] = values
    return result


def points(feature: Feature, path: PairPath, recorded: Record) -> list[int]:
    selection = Selection(features=(feature,))
    return select(selection, score(selection, recorded, path), path, np.array([0])).tolist()


def test_force_above_its_threshold(path: PairPath) -> None:
    recorded = record(column(0, bump(60, 30.0) + bump(90, 8.0)))
    assert points(Feature("force", 10.0), path, recorded) == [0, 60, COUNT - 1]
    assert points(Feature("force", 5.0), path, recorded) == [0, 60, 90, COUNT - 1]
    assert points(Feature("moment", 5.0), path, record(column(4, bump(70, 9.0)))) == [0, 70, COUNT - 1]


def test_correction_and_its_rate(path: PairPath) -> None:
    recorded = record(correction=column(1, bump(60, 1e-3)))
    assert points(Feature("correction", 5e-4), path, recorded) == [0, 60, COUNT - 1]
    steep = points(Feature("correction_rate", 2e-2), path, recorded)
    assert set(steep) == {0, 56, 64, COUNT - 1}
    turned = record(correction=column(5, bump(60, 4e-3)))
    assert points(Feature("correction", 5e-4), path, turned) == [0, 60, COUNT - 1]


def test_force_rate_and_change_since_the_last_block(path: PairPath) -> None:
    recorded = record(column(2, bump(60, 30.0)))
    assert {56, 64} <= set(points(Feature("force_rate", 500.0), path, recorded))
    same = Record(recorded.force, recorded.correction, recorded.force)
    assert points(Feature("change", 1.0), path, same) == [0, COUNT - 1]
    assert 60 in points(Feature("change", 1.0), path, recorded)


def test_features_of_the_command(path: PairPath) -> None:
    fastest = int(np.argmax(np.linalg.norm(np.gradient(path.commands[:, :3, 3], path.dt_s, axis=0), axis=1)))
    assert fastest in points(Feature("speed", 0.3), path, record())
    assert len(points(Feature("acceleration", 1.0), path, record())) > 2
    assert len(points(Feature("turn_rate", 0.2), path, record())) > 2


def test_position_and_time_say_where_points_may_lie(path: PairPath) -> None:
    """Both give 1 inside; with "all" they confine another feature."""
    force = record(column(0, bump(40, 30.0) + bump(90, 20.0)))
    window = Feature("time", windows_s=((0.3, 0.45),))
    half = Feature("position", boxes=(((-9.0, -9.0, -9.0), (9.0, 0.0, 9.0)),))
    for confine, expected in ((window, 90), (half, 40)):
        selection = Selection(features=(Feature("force", 10.0), confine), combination="all")
        chosen = select(selection, score(selection, force, path), path, np.array([0])).tolist()
        assert expected in chosen
        assert 130 - expected not in chosen


def test_a_window_alone_is_filled_with_points(path: PairPath) -> None:
    chosen = points(Feature("time", windows_s=((0.2, 0.3),)), path, record())
    inner = np.array(chosen[1:-1])
    assert len(inner) >= 3
    assert np.all((inner * path.dt_s >= 0.2) & (inner * path.dt_s <= 0.3))
    assert np.diff(inner).min() * path.dt_s >= 0.03


def test_combinations(path: PairPath) -> None:
    recorded = record(column(0, bump(50, 8.0)), column(0, bump(50, 8e-4)))
    features = (Feature("force", 10.0), Feature("correction", 1e-3))
    chosen = {
        kind: select(s := Selection(features, combination=kind), score(s, recorded, path), path, np.array([0])).tolist()
        for kind in ("any", "all", "sum")
    }
    assert chosen == {"any": [0, 125], "all": [0, 125], "sum": [0, 50, 125]}


def test_best_first_and_apart(path: PairPath) -> None:
    force = column(0, bump(60, 30.0, 1.2) + bump(65, 40.0, 1.2) + bump(90, 20.0, 1.2))
    selection = Selection((Feature("force", 10.0),), apart_s=0.03)
    scores = score(selection, record(force), path)
    assert select(selection, scores, path, np.array([0])).tolist() == [0, 65, 90, COUNT - 1]
    few = Selection((Feature("force", 10.0),), largest_count=3)
    assert select(few, scores, path, np.array([0])).tolist() == [0, 65, COUNT - 1]


def test_union_keeps_old_points_and_replace_drops_them(path: PairPath) -> None:
    scores = score(Selection((Feature("force", 10.0),)), record(column(0, bump(60, 30.0))), path)
    old = np.array([0, 30, 100, COUNT - 1])
    assert select(Selection((Feature("force", 10.0),)), scores, path, old).tolist() == [0, 30, 60, 100, COUNT - 1]
    replaced = Selection((Feature("force", 10.0),), keep="replace")
    assert select(replaced, scores, path, old).tolist() == [0, 60, COUNT - 1]


def test_pruning_moves_the_function_by_less_than_its_tolerance() -> None:
    knots = np.tile(np.eye(4), (6, 1, 1))
    knots[:, 0, 3] = [0.0, 1e-3, 2e-3, 3.01e-3, 4.2e-3, 5e-3]
    function = function_of_knots(np.arange(6.0), knots)
    selection = Selection((Feature("force"),))
    pruned = prune(selection, function)
    assert pruned.s_m.tolist() == [0.0, 3.0, 4.0, 5.0]
    lengths = np.linspace(0.0, 5.0, 101)
    moved = np.abs(pruned.many(lengths)[:, 0, 3] - function.many(lengths)[:, 0, 3]).max()
    assert moved < 2.0 * selection.prune_m


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "colour"}, "none of"),
        ({"kind": "force", "threshold": 0.0}, "threshold"),
        ({"kind": "position"}, "boxes"),
        ({"kind": "time"}, "windows_s"),
    ],
)
def test_useless_features_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Feature(**arguments)


def test_selection_without_features_is_refused() -> None:
    with pytest.raises(ConfigError, match="at least one"):
        Selection(features=())


# -- points by what they are worth -------------------------------------------------------------------------------------


def relations(path: PairPath, off_m: np.ndarray, turn_rad: np.ndarray | None = None) -> np.ndarray:
    """Relations (M, 4, 4) that are off along y [m], turned about x [rad]."""
    out = np.tile(np.eye(4), (len(path), 1, 1))
    out[:, 1, 3] = off_m
    if turn_rad is not None:
        out[:, 1, 1] = out[:, 2, 2] = np.cos(turn_rad)
        out[:, 2, 1] = np.sin(turn_rad)
        out[:, 1, 2] = -np.sin(turn_rad)
    return out


STIFFNESS = (1e5, 4e3)


def refined(path: PairPath, wanted: np.ndarray, **changes) -> list[int]:
    recorded = {"gain_n": 3.0, "apart_s": 0.02, "apart_m": 0.0, "refined_count": 30} | changes
    selection = Selection(features=(Feature("force"),), **recorded)
    return refine(selection, wanted, path, np.array([0, COUNT - 1]), STIFFNESS).tolist()


def left_n(path: PairPath, wanted: np.ndarray, chosen: list[int]) -> np.ndarray:
    """Force (M,) that a function through the chosen points leaves along y, by interpolation of its own."""
    lengths, first = np.unique(path.s_m[chosen], return_index=True)
    there = np.interp(path.s_m, lengths, wanted[np.array(chosen)[first], 1, 3])
    return STIFFNESS[0] * np.abs(there - wanted[:, 1, 3])


def test_points_are_added_until_what_they_leave_out_is_small(path: PairPath) -> None:
    wanted = relations(path, bump(60, 4e-4, 8.0))
    chosen = refined(path, wanted)
    assert chosen[0] == 0
    assert chosen[-1] == COUNT - 1
    assert left_n(path, wanted, [0, COUNT - 1]).max() > 30.0
    assert left_n(path, wanted, chosen).max() < 3.0 or len(chosen) == 30
    assert len(refined(path, wanted, gain_n=20.0)) < len(chosen)


def test_a_straight_relation_needs_no_points(path: PairPath) -> None:
    assert refined(path, relations(path, 1e-3 * path.s_m / path.length_m)) == [0, COUNT - 1]


def test_the_best_point_comes_first_and_turning_counts(path: PairPath) -> None:
    wanted = relations(path, bump(40, 1e-4) + bump(80, 3e-4))
    assert refined(path, wanted, refined_count=3) == [0, 80, COUNT - 1]
    turned = relations(path, 0.0 * path.s_m, bump(50, 3e-3))
    assert refined(path, turned, refined_count=3) == [0, 50, COUNT - 1]


def test_added_points_stay_apart_in_time_and_distance(path: PairPath) -> None:
    wanted = relations(path, bump(60, 1e-3, 3.0))
    chosen = np.array(refined(path, wanted, apart_s=0.03, apart_m=0.01))
    assert len(chosen) > 4
    assert np.diff(chosen).min() * path.dt_s >= 0.03 - 1e-9
    assert np.diff(path.s_m[chosen]).min() >= 0.01
