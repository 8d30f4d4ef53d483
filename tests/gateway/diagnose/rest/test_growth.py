"""Memory of a diagnosis grows with the visits, not with their square: peak of allocated bytes at N and at 4 N."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from gateway.data.table import concatenate
from gateway.diagnose.rest.holdout import left_out
from gateway.diagnose.rest.residual_structure import misfit
from gateway.diagnose.rest.search import Search
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import terms_at_rest
from tests.data.resting_arm import Bench, problem_of

#: Poses of the smaller table, each bare and with the load; the larger one has four times as many.
POSES = 12
#: A quadratic array would make this 16.
LARGEST_RATIO = 5.0


@dataclass
class Sized:
    """One table as a problem, the fit without effects, and a search for loads that shifted."""

    problem: RestProblem
    plain: Fit
    search: Search


def sized(bench: Bench, times: int) -> Sized:
    poses = np.random.default_rng(4).uniform(-1.0, 1.0, (POSES * times, 6))
    problem = problem_of(bench, concatenate([bench.table(poses, "none"), bench.table(poses, "tool")]))
    noise = first_noise(problem)
    plain = fit(problem, (), noise, steps=2)
    setup = RestSetup((np.nan,) * 6, False, np.zeros((len(problem.rows), 6)))
    named = terms_at_rest(problem.rows, setup, frozenset({"payload_shift", "torque_offset"}))
    search = Search(problem, tuple(named), (), noise)
    search.pool[frozenset()] = plain
    return Sized(problem, plain, search)


@pytest.fixture(scope="module")
def tables() -> tuple[Sized, Sized]:
    return sized(Bench(3, [], poses=4), 1), sized(Bench(3, [], poses=4), 4)


def peak_bytes(work: Callable[[], object]) -> int:
    """Most bytes that were allocated at once while `work` ran, beyond those before."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        work()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()


STEPS: dict[str, Callable[[Sized], object]] = {
    "candidates": lambda one: one.search.view(one.plain, one.search.named, one.plain.noise.std),
    "structure": lambda one: misfit(one.problem, one.plain),
    "left out": lambda one: left_out(one.problem, one.plain),
    "fit": lambda one: fit(one.problem, (), one.search.noise, one.plain, steps=1),
}


@pytest.mark.parametrize("step", STEPS)
def test_four_times_the_visits_take_four_times_the_memory(tables: tuple[Sized, Sized], step: str) -> None:
    small, large = tables
    STEPS[step](small), STEPS[step](large)  # caching does not count as growth
    ratio = peak_bytes(lambda: STEPS[step](large)) / peak_bytes(lambda: STEPS[step](small))
    assert ratio < LARGEST_RATIO


def test_every_change_point_is_a_candidate_and_weighed_as_its_own_columns_are(tables: tuple[Sized, Sized]) -> None:
    """Sums over the visits from the last one back, against the projected columns of each change for itself."""
    one = tables[0]
    std = one.plain.noise.std
    view = one.search.view(one.plain, one.search.named, std)
    shifts = [k for k, term in enumerate(view.terms) if term.name == "payload_shift"]
    assert len(shifts) >= POSES - 4
    columns = [view.weighted(k) for k in shifts]
    for index, block in zip(shifts, columns, strict=True):
        away = view.basis.left(block)
        matrix = np.eye(block.shape[1]) + block.T @ away
        score = block.T @ view.residual
        expected = 0.5 * score @ np.linalg.solve(matrix, score) - 0.5 * np.linalg.slogdet(matrix)[1]
        assert view.log_bayes[index] == pytest.approx(expected, abs=1e-8)


def test_a_change_point_changes_no_visit_before_it(tables: tuple[Sized, Sized]) -> None:
    one = tables[0]
    view = one.search.view(one.plain, one.search.named, one.plain.noise.std)
    when = one.problem.rows.time_s[one.problem.visit]
    for index, term in enumerate(view.terms):
        if term.name == "payload_shift" and term.until_s is None:  # type: ignore[attr-defined]
            block = view.weighted(index)
            assert not block[when < term.time_s].any()  # type: ignore[attr-defined]
            assert block[when >= term.time_s].any()  # type: ignore[attr-defined]
