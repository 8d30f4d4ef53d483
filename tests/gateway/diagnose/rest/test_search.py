"""Completeness of the search: hypotheses that the first, linearised ranking leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.nature import first_diagnosis, knowledge_of
from benchmarks.nature.nature_cell import draw_cell, draw_effect_cell
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.search import Search, _exchange, run
from gateway.identify.rest.hypothesis_fit import averaged_evidence
from gateway.identify.rest.linear import visit_loads
from gateway.identify.rest.start_noise import settled_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import terms_at_rest
from gateway.model.effects.balancer_spring import CoilBalancer, GasBalancer
from gateway.model.robot import robot_from_urdf
from gateway.model.term import Label, Term
from gateway.model.unnamed import UNNAMED, unnamed_terms
from tests.support.rigs.tables import simulated_table


def searched(seed: int, names: set[str], *balancers: type[Term]) -> Search:
    """A search among some effects and balancers of some types on the first recording of a drawn arm."""
    cell = draw_effect_cell(seed)
    robot = robot_from_urdf(cell.stated.urdf, "drawn")
    diagnosis = RestDiagnosis(robot, knowledge_of(cell))
    read = diagnosis.read(simulated_table(cell.measure(cell.visits)[0], "drawn"))
    problem, plain = read.problem, read.plain
    bodies = problem.model.bodies(plain.setting, plain.links, visit_loads(problem, plain.loads))
    torque, _ = problem.model.joint_torque(plain.setting, bodies)
    setup = RestSetup((np.nan,) * problem.axes, False, torque, problem.links)
    named = terms_at_rest(problem.rows, setup, frozenset(names))
    named = [term for term in named if term.name != "balancer_spring" or isinstance(term, balancers)]
    named = [term for term in named if term.joints in ((), (2,), (3,))]
    unnamed = tuple(term for term in unnamed_terms(problem.rows, setup) if term.joints == (2,))
    return Search(problem, tuple(named), unnamed, settled_noise(problem, plain))


@pytest.mark.parametrize(("seed", "balancers"), [(76, [CoilBalancer]), (30132, [CoilBalancer, GasBalancer])])
def test_a_coil_balancer_is_fitted_from_start_values_that_pull_and_from_others(seed: int, balancers: list) -> None:
    """In one arm, start values that push hide those that pull; in the other, only some that push lead to the spring."""
    search = searched(seed, {"balancer_spring"}, *balancers)
    chosen = run(search)
    assert [type(term) for term in chosen.terms] == [CoilBalancer]
    curve = max(search.score(fit) for fit in search.pool.values() if any(term.name == UNNAMED for term in fit.terms))
    assert search.score(chosen) > curve


@pytest.mark.slow
def test_an_effect_is_exchanged_for_one_that_the_balancer_hides() -> None:
    """The deflection of joint 2 is proportional to the torque that the balancer leaves, not to that of gravity."""
    search = searched(113, {"balancer_spring", "base_tilt", "joint_elasticity"}, GasBalancer)
    places: dict[Label, Term] = {term.label: term for term in search.named}
    beside = (places["balancer_spring", (2,)], places["base_tilt", ()])
    wrong = search.fitted((*beside, places["joint_elasticity", (3,)]), search.fitted(beside))
    _exchange(search)
    assert search.score(search.best()) > search.score(wrong)
    assert {term.label for term in search.best().terms} == {
        ("balancer_spring", (2,)),
        ("base_tilt", ()),
        ("joint_elasticity", (2,)),
    }


def test_a_size_that_cannot_be_negative_has_all_its_prior_on_one_side() -> None:
    """The evidence of a normal prior, over that of its positive half, by integration over both."""
    search = searched(113, {"joint_elasticity", "joint_zero_offset"})
    places: dict[Label, Term] = {term.label: term for term in search.named}
    for label, one_sided in ((("joint_elasticity", (2,)), True), (("joint_zero_offset", (2,)), False)):
        hypothesis = search.fitted([places[label]])
        (size,), std = hypothesis.theta[0], float(np.sqrt(hypothesis.covariance[-1, -1]))
        away = np.linspace(-9.0, 9.0, 20001)
        likelihood_and_prior = np.exp(-0.5 * away**2)
        positive = likelihood_and_prior[size + std * away > 0.0].sum() / likelihood_and_prior.sum()
        assert (size > 0.0) or not one_sided
        expected = np.log(2.0 * positive) if one_sided else 0.0
        shown = search.score(hypothesis) - averaged_evidence(hypothesis) - search.prior[places[label]]
        assert shown == pytest.approx(expected, abs=1e-3)


@pytest.mark.slow
def test_play_of_a_gear_is_no_elasticity() -> None:
    """Without it the deflection of joint 3 was named; every gear has play, and it fits as well."""
    cell = draw_cell(91, "backlash")
    assert not cell.effects
    result = first_diagnosis(cell)
    assert (result.verdict, result.effects) == ("none_needed", ())
