"""Priors of the links: closed forms of the mass, the first moment and the inertia, and what is unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest

from gateway.cell.quantities import inertials_text, parse_inertials
from gateway.errors import ConfigError
from gateway.identify.links import (
    PER_LINK_AT_REST,
    PER_LINK_MOVING,
    as_bodies,
    body_parameters,
    default_link_std,
    has_inertials,
    link_prior,
    link_values,
)
from gateway.model.robot import Robot, link_lengths_m, robot_from_urdf

URDF = Path(__file__).parents[3] / "examples" / "large" / "robot.urdf"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_from_urdf(URDF.read_text(), str(URDF))


def without(robot: Robot, link: int) -> Robot:
    mass, com = robot.mass_kg.copy(), robot.com_m.copy()
    mass[link], com[link] = np.nan, np.nan
    return replace(robot, mass_kg=mass, com_m=com)


def test_parameters_of_a_body_are_those_of_pinocchio():
    com = np.array([0.1, -0.2, 0.3])
    inertia = np.array([[0.4, 0.02, -0.01], [0.02, 0.5, 0.03], [-0.01, 0.03, 0.6]])
    dynamic = pinocchio.Inertia(7.0, com, inertia).toDynamicParameters()
    # pinocchio: m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
    assert body_parameters(7.0, com, inertia) == pytest.approx(dynamic[[0, 1, 2, 3, 4, 5, 7, 6, 8, 9]])


@pytest.mark.parametrize("per_link", [PER_LINK_AT_REST, PER_LINK_MOVING])
def test_prior_is_the_robot_model_with_a_share_of_mass_and_length(robot, per_link):
    mean, std = link_prior(robot, 0.05, per_link)
    length = link_lengths_m(robot)
    for link in range(6):
        mass = robot.mass_kg[link]
        part = slice(per_link * link, per_link * (link + 1))
        assert mean[part][:4] == pytest.approx([mass, *(mass * robot.com_m[link])])
        expected = [0.05 * mass] + [0.05 * mass * length[link]] * 3 + [0.05 * mass * length[link] ** 2] * 6
        assert std[part] == pytest.approx(expected[:per_link])
    assert link_prior(robot, 0.0, per_link)[1].max() == 0.0


def test_links_are_known_as_bodies_mass_place_and_size_apart(robot):
    trust, link, little = 0.05, 2, 1e-5
    mean, std = link_prior(robot, trust, PER_LINK_MOVING)
    rows, right = as_bodies(mean, std)
    mass, com, inertia = robot.mass_kg[link], robot.com_m[link], robot.inertia_kg_m2[link]
    length = link_lengths_m(robot)[link]
    assert rows @ mean == pytest.approx(right)

    def stds_off(*body: Any) -> float:
        changed = mean.copy()
        changed[10 * link : 10 * link + 10] = body_parameters(*body)
        return float(np.linalg.norm(rows @ changed - right))

    assert stds_off((1 + little) * mass, com, inertia) == pytest.approx(little / trust, rel=1e-3)
    assert stds_off(mass, com + [0, little, 0], inertia) == pytest.approx(little / (trust * length), rel=1e-3)
    larger = inertia + little * np.diag([1.0, 0.0, 0.0])
    assert stds_off(mass, com, larger) == pytest.approx(little / (trust * mass * length**2), rel=1e-3)


@pytest.mark.parametrize("per_link", [PER_LINK_AT_REST, PER_LINK_MOVING])
def test_what_is_unknown_is_open_and_not_massless(robot, per_link):
    mean, std = link_prior(without(robot, 2), 0.05, per_link)
    part = slice(2 * per_link, 3 * per_link)
    assert np.isinf(std[part]).all()
    assert not mean[part].any()
    assert np.isfinite(np.delete(std, np.arange(part.start, part.stop))).all()
    assert np.isinf(link_prior(robot, np.inf, per_link)[1]).all()


def test_an_unknown_inertia_of_a_known_mass_is_around_zero(robot):
    inertia = robot.inertia_kg_m2.copy()
    inertia[4] = np.nan
    mean, std = link_prior(replace(robot, inertia_kg_m2=inertia), 0.1, PER_LINK_MOVING)
    assert mean[40] == pytest.approx(robot.mass_kg[4])
    assert np.array_equal(mean[44:50], np.zeros(6))
    assert np.isfinite(std[44:50]).all()


def test_has_inertials_asks_for_every_link(robot):
    assert has_inertials(robot)
    assert not has_inertials(without(robot, 5))
    massless = robot.mass_kg.copy()
    massless[1] = 0.0
    assert not has_inertials(replace(robot, mass_kg=massless))
    assert np.isnan(link_values(without(robot, 5))[5]).all()


@pytest.mark.parametrize(
    ("text", "share"),
    [
        ("exact", 0.0),
        ("ignore", np.inf),
        ("prior:0.05", 0.05),
        ("prior:2", 2.0),
        ("prior:1e-3", 1e-3),
        ("0.05", 0.05),
        ("0", 0.0),
    ],
)
def test_trust_in_the_robot_model_is_read_from_a_word(text, share):
    assert parse_inertials(text) == share
    assert parse_inertials(inertials_text(share)) == share


@pytest.mark.parametrize(
    "text", ["", "-0.05", "prior", "prior:", "prior:x", "prior:0", "prior:-1", "prior:nan", "prior:inf"]
)
def test_any_other_word_is_refused(text):
    with pytest.raises(ConfigError, match="use a relative standard deviation such as"):
        parse_inertials(text)


def test_a_robot_model_is_trusted_by_default_as_far_as_it_states_values(robot):
    assert default_link_std(robot) == default_link_std(without(robot, 2)) == 0.05
    assert default_link_std(replace(robot, mass_kg=np.full(6, np.nan))) == np.inf
