"""Representative corrections and the store, against numpy, scipy and the recursions they lead to."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.pair.iterative_learning import CorrectionStore
from gateway.pair.learning_update import half_sample_mode, representative


def test_mean_and_median_by_component() -> None:
    values = np.random.default_rng(1).normal(size=(7, 4, 6))
    assert np.allclose(representative(values, "mean"), np.mean(values, axis=0))
    assert np.allclose(representative(values, "median"), np.median(values, axis=0))


def test_weights_fall_with_age() -> None:
    values = np.array([[1.0], [2.0], [4.0]])
    expected = (0.49 * 1.0 + 0.7 * 2.0 + 4.0) / (0.49 + 0.7 + 1.0)
    assert representative(values, "weighted")[0] == pytest.approx(expected)


def test_mode_ignores_outliers_and_needs_five() -> None:
    values = np.array([[0.10, 9.0], [0.11, 0.2], [0.10, 0.21], [5.0, 0.2], [-3.0, -7.0]])
    assert np.allclose(representative(values, "mode"), [0.10, 0.2], atol=0.01)
    assert np.allclose(representative(values[:4], "mode"), np.median(values[:4], axis=0))


def test_half_sample_mode_by_hand() -> None:
    """Robertson and Cryer: halves 1..1.6 of the ten, then 1.2..1.6, then 1.2..1.4 with the smaller gap 1.3..1.4."""
    sample = np.array([1.0, 1.2, 1.3, 1.4, 1.6, 2.5, 3.5, 5.0, 8.0, 13.0])
    assert half_sample_mode(sample[:, None])[0] == pytest.approx(1.3, abs=0.051)


def test_one_snag_among_equal_cycles_does_not_move_the_median() -> None:
    values = np.full((5, 6), 1e-4)
    values[2] += 1e-3
    assert np.array_equal(representative(values, "median"), np.full(6, 1e-4))
    assert np.allclose(representative(values, "mean"), 3e-4)


def test_unknown_kind_and_empty_store_are_refused() -> None:
    with pytest.raises(ConfigError, match="none of"):
        representative(np.zeros((2, 6)), "best")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="at least one"):
        representative(np.zeros((0, 6)), "mean")


def test_store_keeps_the_newest_cycles() -> None:
    store = CorrectionStore(3, 4)
    for cycle in range(5):
        store.add(np.full((4, 2, 6), float(cycle)))
        assert store.full == (cycle >= 2)
    assert store.corrections[:, 0, 0, 0].tolist() == [2.0, 3.0, 4.0]
    store.rereference(np.stack([np.zeros((4, 6)), np.ones((4, 6))], axis=1))
    assert store.corrections[:, 0, 1, 0].tolist() == [1.0, 2.0, 3.0]
    assert store.corrections[:, 0, 0, 0].tolist() == [2.0, 3.0, 4.0]
    store.clear()
    assert len(store) == 0


def test_store_refuses_wrong_shapes_and_values() -> None:
    store = CorrectionStore(2, 4)
    with pytest.raises(ConfigError, match="shape"):
        store.add(np.zeros((3, 2, 6)))
    with pytest.raises(ConfigError, match="finite"):
        store.add(np.full((4, 2, 6), np.nan))
    with pytest.raises(ConfigError, match="at least 1"):
        CorrectionStore(0, 4)


def largest_root(cycles: int, gain: float = 1.0) -> float:
    """Spectral radius of e_(n+1) = e_n - (g/R) sum of the last R errors."""
    matrix = np.zeros((cycles, cycles))
    matrix[0] = -gain / cycles
    matrix[0, 0] += 1.0
    matrix[1:, :-1] += np.eye(cycles - 1)
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def test_sliding_mean_becomes_unstable_at_five() -> None:
    assert [round(largest_root(cycles), 2) for cycles in (2, 3, 4)] == [0.71, 0.89, 0.97]
    assert largest_root(5) == pytest.approx(1.007, abs=1e-3)
    assert largest_root(10) == pytest.approx(1.05, abs=5e-3)


def learned_error(cycles: int, updates: int, schedule: str) -> list[float]:
    """A scalar learning law on the store: error of each cycle while its correction takes all of it away."""
    store, offset, function, errors = CorrectionStore(cycles, 2), 1.0, 0.0, []
    for _ in range(updates):
        error = offset - function
        errors.append(error)
        store.add(np.full((2, 2, 6), error))
        if schedule == "block" and not store.full:
            continue
        change = float(representative(store.corrections, "mean")[0, 1, 0])
        function += change
        if schedule == "block":
            store.clear()
        elif schedule == "rereferenced":
            store.rereference(np.full((2, 2, 6), change))
    return errors


def test_block_and_rereferenced_schedules_converge_where_the_sliding_one_does_not() -> None:
    assert abs(learned_error(5, 60, "block")[-1]) < 1e-12
    assert abs(learned_error(5, 60, "rereferenced")[-1]) < 1e-12
    sliding = np.abs(learned_error(5, 400, "sliding"))
    assert sliding[-30:].max() > 2.0 * sliding[40:70].max()
