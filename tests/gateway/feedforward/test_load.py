"""Which load is fed: identified on this arm, or the rated one; everything else is refused with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drives.profile_file import load_profile
from gateway.cell.config import SourcedNumber
from gateway.errors import ConfigError, DataUnusable, InputError
from gateway.feedforward.identified import corrected_parameters, drawn_parameters
from gateway.feedforward.law import axis_terms
from gateway.feedforward.load import check_origin, cube_inertia, identified_load, rated_load
from gateway.model.base import rest_base
from gateway.model.regressor import gravity_regressor
from gateway.result.drawn import Drawn
from gateway.result.result import Bare, LoadResult, Result

GRAVITY = np.array([0.0, 0.0, -9.80665])
LOAD = LoadResult("a", 70.0, 0.2, (0.05, -0.02, 0.22), (0.001, 0.001, 0.002))


def result(*loads, **changes):
    data = {"cell": "large", "arm": "main"}
    return Result(**{"robot": "qh165", "loads": loads, "extra": {"data": data}} | changes)


def test_the_identified_load_is_taken_with_its_own_inertia_assumed_and_said_so():
    load = identified_load(result(LOAD), None, "r.json")
    assert (load.mass_kg, load.mass_std_kg, load.com_m.tolist()) == (70.0, 0.2, [0.05, -0.02, 0.22])
    assert load.inertia_source.startswith("assumed")
    # solid cube of 70 kg at 3000 kg/m3: a = 0.2858 m, m a^2 / 6
    np.testing.assert_allclose(load.inertia_kg_m2, np.eye(3) * 70.0 / 6.0 * (70.0 / 3000.0) ** (2 / 3))
    assert load.parameters[0] == 70.0
    assert load.parameters[1:4].tolist() == pytest.approx([3.5, -1.4, 15.4])


def test_a_cube_has_the_inertia_of_a_cube():
    assert cube_inertia(3000.0)[0, 0] == pytest.approx(500.0)


@pytest.mark.parametrize(
    ("held", "label", "error", "words"),
    [
        (result(), None, DataUnusable, "no identified load"),
        (result(replace(LOAD, refused="contradictory")), None, DataUnusable, "contradictory"),
        (result(replace(LOAD, com_m=(0.0, 0.0, float("nan")), unidentifiable=("com z",))), None, DataUnusable, "com z"),
        (result(replace(LOAD, mass_kg=float("nan"))), None, DataUnusable, "mass"),
        (result(replace(LOAD, frame="flange")), None, InputError, "frame 'flange'"),
        (result(LOAD), "b", ConfigError, "holds a"),
        (result(LOAD, replace(LOAD, label="b")), None, ConfigError, "--load"),
    ],
)
def test_what_is_no_identified_load_is_refused(held, label, error, words):
    with pytest.raises(error, match=words):
        identified_load(held, label, "r.json")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": "kr300"}, "robot 'kr300'"),
        ({"data": Drawn(cell="small")}, "cell 'small'"),
        ({"data": Drawn(arm="left")}, "arm 'left'"),
    ],
)
def test_the_load_of_another_arm_is_refused(large_cell, qh165, changes, words):
    arm = large_cell.cell.arm[0]
    check_origin(result(LOAD), large_cell, arm, qh165, "r.json")
    with pytest.raises(InputError, match=words):
        check_origin(result(LOAD, **changes), large_cell, arm, qh165, "r.json")


def test_the_maximum_is_the_rated_load_else_the_heaviest_else_refused(large_cell, qh165):
    arm = large_cell.cell.arm[0]
    assert rated_load(arm, qh165).mass_kg == 165.0
    heaviest = arm.model_copy(update={"rated_load_kg": None, "max_load_kg": 90.0, "max_load_com_m": (0.0, 0.0, 0.2)})
    assert rated_load(heaviest, qh165).com_m.tolist() == [0.0, 0.0, 0.2]
    with pytest.raises(ConfigError, match="rated_load_kg is missing"):
        rated_load(arm.model_copy(update={"rated_load_kg": None}), qh165)


def test_what_is_not_given_is_left_out_and_said_so(large_cell):
    arm = large_cell.cell.arm[0]
    profiles = [load_profile("generic-cia402")] * 6
    axes, sources = axis_terms(arm, profiles, None)
    assert axes[1].rotor_kg_m2 == 305.0
    assert sources[1].missing == ("Coulomb friction", "viscous friction")
    axes, sources = axis_terms(arm, profiles, result(LOAD, friction_band_nm=(78.0, 104.0, 63.0, 21.0, 16.0, 11.0)))
    assert axes[1].coulomb_nm == 104.0
    assert sources[1].missing == ("viscous friction",)
    numbers = {"viscous_nm_s_rad": SourcedNumber(value=90.0, source="identified"), "rotor_inertia_kg_m2": None}
    first = arm.model_copy(update={"axis": (arm.axis[0].model_copy(update=numbers), *arm.axis[1:])})
    axes, sources = axis_terms(first, profiles, None)
    assert (axes[0].viscous_nm_s_rad, axes[0].rotor_kg_m2) == (90.0, 0.0)
    assert sources[0].missing == ("rotor inertia", "Coulomb friction")


def test_a_profile_without_the_objects_is_refused_and_its_axes_named(large_cell):
    profiles = [load_profile("generic-cia402")] * 5 + [load_profile("kollmorgen-akd-x00606")]
    with pytest.raises(ConfigError, match=r"axis 6 \(node 6, kollmorgen-akd-x00606\)"):
        axis_terms(large_cell.cell.arm[0], profiles, None)


def test_links_that_are_not_known_are_refused(large_cell, qh165):
    arm = large_cell.cell.arm[0]
    with pytest.raises(ConfigError, match="link 3"):
        drawn_parameters(replace(qh165, mass_kg=np.where(np.arange(6) == 2, np.nan, qh165.mass_kg)), arm)
    with pytest.raises(ConfigError, match="ignore"):
        drawn_parameters(qh165, arm.model_copy(update={"inertials": "ignore"}))


@pytest.fixture
def bare(qh165):
    """Identification of an arm whose links are not those of the drawing."""
    base = rest_base(qh165, GRAVITY)
    rng = np.random.default_rng(3)
    mass = qh165.mass_kg * (1 + 0.05 * rng.normal(size=6))
    com = qh165.com_m + 0.02 * rng.normal(size=(6, 3))
    moments = np.column_stack([mass, mass[:, None] * com]).ravel()
    value = base.combination @ moments
    return moments, Bare(
        robot="qh165",
        gravity_m_s2=tuple(GRAVITY),
        columns=tuple(base.indices.tolist()),
        names=base.names,
        value=tuple(value.tolist()),
        covariance=(),
        combination=tuple(map(tuple, base.combination.tolist())),
    )


def test_the_links_are_corrected_to_the_torque_that_was_identified(large_cell, qh165, bare):
    truth, identified = bare
    drawn = drawn_parameters(qh165, large_cell.cell.arm[0])
    corrected = corrected_parameters(qh165, identified, GRAVITY)
    rows = gravity_regressor(qh165, np.random.default_rng(0).uniform(-2, 2, (50, 6)), GRAVITY)
    moments = [part.reshape(6, 10)[:, :4].ravel() for part in (drawn, corrected)]
    assert np.abs(rows @ (moments[0] - truth)).max() > 50.0
    np.testing.assert_allclose(rows @ moments[1], rows @ truth, atol=1e-6)
    # inertia about each link's own centre of mass is the drawing's
    for number in range(6):
        mass, moment, upper = corrected[10 * number], corrected[10 * number + 1 : 10 * number + 4], None
        about = np.zeros((3, 3))
        about[np.triu_indices(3)] = corrected[10 * number + 4 : 10 * number + 10]
        upper = about - mass * ((moment @ moment) / mass**2 * np.eye(3) - np.outer(moment, moment) / mass**2)
        expected = qh165.inertia_kg_m2[number][np.triu_indices(3)]
        np.testing.assert_allclose(upper[np.triu_indices(3)], expected, atol=1e-9)


def test_an_identification_that_does_not_apply_corrects_nothing(qh165, bare):
    _, identified = bare
    assert corrected_parameters(qh165, replace(identified, robot="other"), GRAVITY) is None
    assert corrected_parameters(qh165, identified, np.array([0.0, 9.8, 0.0])) is None
    absurd = replace(identified, value=tuple(-3.0 * value for value in identified.value))
    assert corrected_parameters(qh165, absurd, GRAVITY) is None
