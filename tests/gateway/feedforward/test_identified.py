"""What was identified in motion comes before what was typed; what contradicts is refused, the missing falls back."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from drives.profile_file import load_profile
from gateway.cell.config import SourcedNumber, load_cell
from gateway.errors import InputError
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.identified import axis_constants, drawn_parameters, notes_of, read_identified, with_identified
from gateway.feedforward.law import axis_terms
from gateway.feedforward.load import identified_load
from gateway.result.drawn import Drawn
from gateway.result.result import AxisMotion, LoadResult, Result, to_json
from tests.gateway.feedforward.conftest import EXAMPLES

#: As identified by a run in motion for axis 2 of the large arm, of which a rotor of 305 kg m2 is typed and no friction.
AXIS_2 = AxisMotion(
    2,
    coulomb_nm=95.0,
    coulomb_std_nm=1.0,
    viscous_nm_s_rad=90.0,
    viscous_std_nm_s_rad=2.0,
    breakaway_nm=110.0,
    breakaway_std_nm=3.0,
    stribeck_rad_s=0.02,
    load_friction=0.03,
    load_friction_std=0.004,
    rotor_inertia_kg_m2=290.0,
    rotor_inertia_std_kg_m2=4.0,
)
SOURCE = "identified, result.json of 2026-05-04 10:00 UTC"


def identified_axes(*axes, **changes):
    data = Drawn(cell="large", arm="main", created="2026-05-04 10:00 UTC")
    return Result(**{"robot": "qh165", "motion": axes, "data": data} | changes)


@pytest.fixture
def cell(tmp_path):
    """Factory: a result -> the large example cell that names it."""

    def placed(result, sealed=True):
        for name in ("cell.toml", "robot.urdf"):
            shutil.copy(EXAMPLES / "large" / name, tmp_path / name)
        text = (tmp_path / "cell.toml").read_text().replace('bus = "a"', 'bus = "a"\nidentified = "result.json"', 1)
        (tmp_path / "cell.toml").write_text(text)
        plain = json.loads(to_json(result))
        (tmp_path / "result.json").write_text(json.dumps(plain if sealed else {**plain, "sha256": None}))
        return load_cell(tmp_path / "cell.toml")

    return placed


def constants(loaded, qh165, typed=None):
    arm = loaded.cell.arm[0]
    if typed is not None:
        arm = arm.model_copy(update={"axis": (arm.axis[0], arm.axis[1].model_copy(update=typed), *arm.axis[2:])})
    return axis_constants(arm, read_identified(loaded, arm, qh165))


def typed(value):
    return SourcedNumber(value=value, source="datasheet p. 9")


def test_what_was_identified_comes_before_what_was_typed_with_file_and_date(cell, qh165):
    loaded = cell(identified_axes(AXIS_2))
    known = constants(loaded, qh165, {"coulomb_nm": typed(80.0)})
    assert [known[1].rotor_kg_m2.value, known[1].coulomb_nm.value, known[1].viscous_nm_s_rad.value] == [
        290.0,
        95.0,
        90.0,
    ]
    assert {known[1].rotor_kg_m2.source, known[1].coulomb_nm.source} == {SOURCE}
    assert (known[1].breakaway_nm, known[1].stribeck_rad_s, known[1].load_friction) == (110.0, 0.02, 0.03)
    assert known[1].notes == ()
    # an axis that motion did not identify keeps what is typed
    assert (known[0].rotor_kg_m2.value, known[0].rotor_kg_m2.source) == (
        220.0,
        "datasheet p. 4, times gear ratio squared",
    )
    assert known[0].coulomb_nm is None


def test_a_cell_that_names_no_result_keeps_what_is_typed(large_cell, qh165):
    assert read_identified(large_cell, large_cell.cell.arm[0], qh165) is None
    assert constants(large_cell, qh165)[1].rotor_kg_m2.value == 305.0


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        (
            {"rotor_inertia_kg_m2": float("nan")},
            "rotor_kg_m2",
            "rotor inertia was not identified: the stated value is used",
        ),
        (
            {"rotor_inertia_std_kg_m2": 200.0},
            "rotor_kg_m2",
            "is too large (290 ± 390 kg m2): the stated value",
        ),
        ({"rotor_inertia_std_kg_m2": float("nan")}, "rotor_kg_m2", "is too large"),
        (
            {"viscous_nm_s_rad": float("nan")},
            "viscous_nm_s_rad",
            "viscous friction was not identified: the term is left out",
        ),
    ],
)
def test_what_is_missing_or_poorly_known_falls_back_and_is_said(cell, qh165, changes, key, words):
    known = constants(cell(identified_axes(replace(AXIS_2, **changes))), qh165)[1]
    one = getattr(known, key)
    assert one is None if key.startswith("viscous") else (one.value, one.identified) == (305.0, False)
    assert len(known.notes) == 1
    assert words in known.notes[0]
    assert list(notes_of([(), known.notes])) == [("J2", known.notes[0])]


def test_typed_friction_is_not_mixed_with_parts_of_an_identified_curve(cell, qh165):
    half = replace(AXIS_2, coulomb_nm=float("nan"))
    known = constants(cell(identified_axes(half)), qh165, {"coulomb_nm": typed(80.0)})[1]
    assert (known.coulomb_nm.value, known.load_friction) == (80.0, 0.0)
    assert np.isnan([known.breakaway_nm, known.stribeck_rad_s]).all()


@pytest.mark.parametrize(
    ("changes", "cell_says", "words"),
    [
        ({"coulomb_nm": -20.0}, {}, "J2 Coulomb friction is negative"),
        ({"rotor_inertia_kg_m2": 0.0069, "rotor_inertia_std_kg_m2": 0.0001}, {}, "J2 rotor inertia: .* 305 is stated"),
        ({}, {"viscous_nm_s_rad": typed(9.0)}, "J2 viscous friction: .* 9 is stated"),
    ],
)
def test_what_contradicts_is_refused(cell, qh165, changes, cell_says, words):
    loaded = cell(identified_axes(replace(AXIS_2, **changes)))
    with pytest.raises(InputError, match=words) as raised:
        constants(loaded, qh165, cell_says)
    assert "result.json" in str(raised.value)


def test_what_differs_by_more_than_twice_is_used_and_said(cell, qh165):
    known = constants(cell(identified_axes(AXIS_2)), qh165, {"viscous_nm_s_rad": typed(40.0)})[1]
    assert known.viscous_nm_s_rad.value == 90.0
    assert known.notes == ("viscous friction: 90.0 ± 3.9 Nm s/rad was identified and is used; 40 is stated",)


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (identified_axes(AXIS_2, robot="kr300"), "robot 'kr300', not on 'qh165'"),
        (identified_axes(AXIS_2, data=Drawn(cell="large", arm="left")), "arm 'left', not on 'main'"),
        (identified_axes(AXIS_2, data=Drawn(cell="small", arm="main")), "cell 'small', not on 'large'"),
        (identified_axes(AXIS_2, data=None), "names no cell and arm"),
        (identified_axes(), "record CELL --plan"),
        (identified_axes(AXIS_2, AXIS_2), "joint 2 is given twice"),
        (identified_axes(AXIS_2, replace(AXIS_2, joint=7)), "joint 7"),
    ],
)
def test_a_result_that_is_not_of_this_arm_is_refused(cell, qh165, result, words):
    loaded = cell(result)
    with pytest.raises(InputError, match=words):
        read_identified(loaded, loaded.cell.arm[0], qh165)


def test_a_result_without_checksum_or_edited_is_refused(cell, qh165):
    loaded = cell(identified_axes(AXIS_2), sealed=False)
    with pytest.raises(InputError, match=r"checksum|edited"):
        read_identified(loaded, loaded.cell.arm[0], qh165)
    path = loaded.path("result.json")
    plain = json.loads(to_json(identified_axes(AXIS_2)))
    path.write_text(json.dumps({key: value for key, value in plain.items() if key != "sha256"}))
    with pytest.raises(InputError, match="checksum"):
        read_identified(loaded, loaded.cell.arm[0], qh165)
    plain["motion"][0]["coulomb_nm"] = 1.0
    path.write_text(json.dumps(plain))
    with pytest.raises(InputError, match="edited"):
        read_identified(loaded, loaded.cell.arm[0], qh165)


def test_another_file_takes_the_place_of_the_cells(cell, qh165, tmp_path):
    loaded = cell(identified_axes(AXIS_2))
    other = tmp_path / "later.json"
    other.write_text(to_json(identified_axes(replace(AXIS_2, coulomb_nm=99.0))))
    changed = with_identified(loaded, "main", other)
    assert constants(changed, qh165)[1].coulomb_nm.value == 99.0
    assert with_identified(loaded, "main", None) is loaded


def test_the_offsets_take_it_and_the_rest_poses_only_where_nothing_else_is_known(cell, qh165):
    loaded = cell(identified_axes(AXIS_2))
    arm = loaded.cell.arm[0]
    rest = Result(robot="qh165", friction_band_nm=(78.0, 104.0, 63.0, 21.0, 16.0, 11.0))
    identified = read_identified(loaded, arm, qh165)
    axes, sources = axis_terms(arm, [load_profile("generic-cia402")] * 6, rest, identified)
    assert (axes[1].coulomb_nm, axes[1].viscous_nm_s_rad, axes[1].rotor_kg_m2) == (95.0, 90.0, 290.0)
    assert (axes[1].onset_nm, axes[1].stribeck_rad_s, axes[1].load_friction) == (15.0, 0.02, 0.03)
    assert sources[1].missing == ()
    assert sources[1].coulomb == f"{SOURCE}, with 110 Nm breakaway torque"
    assert (sources[1].rotor_inertia, sources[1].viscous) == (SOURCE, SOURCE)
    assert (axes[1].efficiency, axes[0].efficiency) == (0.8, 0.8)
    assert sources[1].gear_losses == f"assumed; 3 % of the torque in addition, {SOURCE}"
    assert sources[0].gear_losses == "assumed"
    assert (axes[0].coulomb_nm, axes[0].onset_nm) == (78.0, 0.0)
    assert sources[0].coulomb == "friction band of the rest poses"


# -- the load's own inertia --------------------------------------------------------------------------------------------

BODY = LoadResult("a", 70.0, 0.2, (0.05, -0.02, 0.22), (0.001,) * 3, inertia_kg_m2=(2.0, 3.0, 1.5, 0.4, -0.3, 0.2))
ROTATED = np.array([[2.0, 0.4, -0.3], [0.4, 3.0, 0.2], [-0.3, 0.2, 1.5]])


def test_the_identified_inertia_of_a_load_moves_the_arm_as_pinocchio_says(large_cell, qh165):
    """Off-diagonals, frame and centre: torque of the arm with the body on its last link."""
    load = identified_load(identified_axes(loads=(BODY,)), None, "result.json")
    assert load.inertia_source == SOURCE
    parameters = drawn_parameters(qh165, large_cell.cell.arm[0])
    parameters[50:] += load.parameters
    model = pinocchio.buildModelFromUrdf(str(EXAMPLES / "large" / "robot.urdf"))
    model.gravity.linear = np.array(large_cell.cell.arm[0].gravity_m_s2)
    body = pinocchio.Inertia(70.0, np.array([0.05, -0.02, 0.22]), ROTATED)
    model.appendBodyToJoint(6, body, pinocchio.SE3.Identity())
    data, random = model.createData(), np.random.default_rng(4)
    dynamics = ArmDynamics(qh165, parameters)
    for _ in range(5):
        q, qd, qdd = random.uniform(-1.5, 1.5, (3, 6))
        expected = pinocchio.rnea(model, data, q, qd, qdd)
        assert dynamics.torque(q.tolist(), qd.tolist(), qdd.tolist()) == pytest.approx(expected.tolist(), rel=1e-9)


@pytest.mark.parametrize(
    ("inertia", "words"),
    [
        ((2.0, 3.0, float("nan"), 0.0, 0.0, 0.0), "only partly identified"),
        ((0.5, 0.5, 1.5, 0.0, 0.0, 0.0), "is physically impossible"),
        ((-0.5, 0.5, 1.5, 0.0, 0.0, 0.0), "is physically impossible"),
    ],
)
def test_an_inertia_that_is_not_whole_or_of_no_body_is_assumed_and_said_so(inertia, words):
    load = identified_load(identified_axes(loads=(replace(BODY, inertia_kg_m2=inertia),)), None, "result.json")
    assert load.inertia_source.startswith("assumed: solid cube")
    assert words in load.inertia_source
    assert load.inertia_kg_m2[0, 1] == 0.0
