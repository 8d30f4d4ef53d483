"""Mass that is taken off a link: as far as the link goes it corrects the drawing, beyond that it names nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.nature import first_diagnosis
from benchmarks.nature.nature_cell import draw_effect_cell
from gateway.diagnose.rest.rest_outcome import contradicted
from gateway.diagnose.rest.search import Search
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import terms_at_rest
from gateway.model.effects.link_mass import LinkMass
from gateway.model.visits import pair_visits
from tests.data.resting_arm import Bench, effect

#: Link 3, from 0.
LINK = 2


@pytest.fixture(scope="module")
def lighter() -> tuple[Bench, Search, LinkMass]:
    """An arm whose link 3 weighs half of what the drawing says, its drawing trusted to 1 %."""
    plain = Bench(3, [], poses=8)
    mass = float(plain.robot.mass_kg[LINK])
    bench = Bench(3, [effect("link_mass", [LINK + 1], mass_kg=-0.5 * mass)], poses=8)
    rows = pair_visits(bench.both(), bench.options.efficiency)
    problem = build_problem(bench.robot, rows, Knowledge(link_std=0.01))
    setup = RestSetup((np.nan,) * 6, False, np.zeros((len(rows), 6)), problem.links)
    named = terms_at_rest(problem.rows, setup, frozenset({"link_mass"}))
    term = next(term for term in named if isinstance(term, LinkMass) and term.axis == LINK)
    heavy = LinkMass(LINK, tuple(0.1 * value for value in term.drawn or ()), term.arm_kg)  # type: ignore[arg-type]
    return bench, Search(problem, (*named, heavy), (), first_noise(problem)), heavy


def test_the_drawing_of_a_link_comes_with_the_candidate(lighter: tuple[Bench, Search, LinkMass]) -> None:
    bench, search, _ = lighter
    own = [term for term in search.named if isinstance(term, LinkMass)]
    masses = [term.drawn[0] for term in own[:-1] if term.drawn is not None]
    assert masses == pytest.approx(bench.robot.mass_kg[1:4])


def test_more_than_the_whole_link_is_never_the_answer(lighter: tuple[Bench, Search, LinkMass]) -> None:
    """The same columns, the same fit: where the link is drawn as light as a tenth, minus half of it cannot be."""
    _, search, light = lighter
    plain = search.fitted(())
    real = next(term for term in search.named if isinstance(term, LinkMass) and term.axis == LINK)
    possible, impossible = search.fitted([real], plain), search.fitted([light], plain)
    assert possible.theta[0] == pytest.approx(impossible.theta[0])
    assert possible.theta[0][0] < -0.3 * real.drawn[0]  # type: ignore[index]
    assert search.score(possible) > search.score(plain) > search.score(impossible)
    assert search.best() is possible


@pytest.mark.parametrize(
    ("theta", "std", "exists"),
    [
        ([-4.0, 0.0, 0.0, 0.0], [0.1] * 4, True),
        ([-7.0, 0.0, 0.0, 0.0], [0.1] * 4, False),
        ([-7.0, 0.0, 0.0, 0.0], [2.0, 0.1, 0.1, 0.1], True),  # it may as well be -4
        ([5.0, 0.0, 15.0, 0.0], [0.1] * 4, True),
        ([5.0, 0.0, 30.0, 0.0], [0.1] * 4, False),  # nearly 3 m off the joint
        ([90.0, 0.0, 0.0, 0.0], [0.1] * 4, False),  # heavier than the arm
    ],
)
def test_what_can_be_on_a_link(theta: list[float], std: list[float], exists: bool) -> None:
    term = LinkMass(LINK, (5.0, 0.5, 0.0, 0.2), 60.0)
    assert term.exists(np.array(theta), np.array(std)) is exists
    assert LinkMass(LINK).exists(np.array(theta), np.array(std))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [546, 919, 407])
def test_a_body_on_a_link_is_named_where_only_the_drawing_shows_it(seed: int) -> None:
    """Wrong links fit the poses as well: the body is far beyond what is stated of the drawing.

    In the last arm the links as stated are contradicted; one body is more likely than links that are all wrong.
    """
    cell = draw_effect_cell(seed)
    assert [(each.mechanism, each.joints) for each in cell.effects] == [("dressed_link", (4,))]
    result = first_diagnosis(cell, "link_mass", "torque_constant_scale", "balancer_spring")
    assert [(each.name, each.joints) for each in result.effects] == [("link_mass", (4,))]


@pytest.mark.parametrize(
    ("ratios", "taken"),
    [
        ({"link_mass": 1.0}, False),  # wrong links fit the held-out rows as well
        ({"cable_torque": 1.0}, True),
        ({"link_mass": 1.0, "cable_torque": 1.0}, False),
        ({"link_mass": 1.0, "cable_torque": 0.9}, False),
    ],
)
def test_held_out_rows_take_no_body_on_a_link_away(ratios: dict[str, float], taken: bool) -> None:
    named = [
        SimpleNamespace(name=name, evidence=SimpleNamespace(holdout_rms_ratio=value)) for name, value in ratios.items()
    ]
    seen = SimpleNamespace(held=None)
    for verdict in ("improved", "explained"):
        decision = SimpleNamespace(verdict=verdict, after=None)
        assert contradicted(None, decision, seen, named) == (taken and verdict == "improved")  # type: ignore[arg-type]
