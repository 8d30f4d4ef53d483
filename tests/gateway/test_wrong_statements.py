"""Statements about an arm that the data contradict, from the command line: named, refused, or the load is right anyway.

The arms are those of `benchmarks.conflict`, whose torques come from pinocchio; here their torque constants are exact
and their links as stated. The wrong statement is then the only one that is named.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.conflict.answers import typed
from benchmarks.conflict.conditions import CONDITIONS
from benchmarks.conflict.plant import ConflictCell, draw_cell, measure

COMMANDS = ("estimate", pytest.param("diagnose", marks=pytest.mark.slow))


def quiet_cell(condition: str = "clean", seed: int = 0) -> ConflictCell:
    """Measure a cell with exact constants and links, whose visits repeat to a hundredth of the friction band."""
    cell = draw_cell(seed)
    cell.true = cell.stated.copy()
    cell.gain[:] = 0.0
    cell.scatter = 0.01
    CONDITIONS[condition].before(cell)
    cell.columns = measure(cell)
    CONDITIONS[condition].after(cell)
    return cell


def changed_axis(cell: ConflictCell, other: dict[str, np.ndarray]) -> int:
    """Return the joint whose columns differ from those of the plain cell."""
    return next(axis for axis in range(1, 7) if (cell.columns[f"tau{axis}_nm"] != other[f"tau{axis}_nm"]).any())


def warnings(result: dict) -> list[dict]:
    return [finding for finding in result["findings"] if finding["severity"] in ("warn", "fail")]


def off(result: dict, cell: ConflictCell) -> float:
    """Return how many stated standard deviations the mass is off."""
    load = next(load for load in result["loads"] if load["label"] == "tool")
    return abs(load["mass_kg"] - cell.loads["tool"][0]) / load["mass_std_kg"]


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("condition", ["clean", "known mass"])
def test_right_statements_raise_no_warning(condition, command, tmp_path):
    cell = quiet_cell(condition)
    code, _, result = typed(cell, tmp_path, command)
    assert code == 0
    assert warnings(result) == []
    assert result["effects"] == []
    assert off(result, cell) < 2.0


@pytest.mark.parametrize("command", COMMANDS)
def test_reversed_torque_of_one_axis_is_named(command, tmp_path):
    cell = quiet_cell("torque sign, one axis")
    joint = changed_axis(cell, quiet_cell().columns)
    code, _, result = typed(cell, tmp_path, command)
    assert code == 7
    named = {f["where"] for f in result["findings"] if "sign is reversed" in f["what"]}
    assert named == {f"J{joint}"}


def test_noise_floor_comes_from_repeats_where_the_model_lacks_a_torque(tmp_path):
    """A torque of sin(2 q2) on J2 that nothing declares must not pass as noise."""
    cell = quiet_cell("undeclared sin(2 q2)")
    _, _, result = typed(cell, tmp_path)
    assert "J2" in {finding["where"] for finding in warnings(result)}
    band_nm, wave_nm = cell.friction.coulomb_nm[1], 0.1 * cell.size_nm[1]
    floor_nm = result["noise_floor_nm"][1]
    assert floor_nm < 0.05 * band_nm
    assert floor_nm < 0.2 * wave_nm


@pytest.mark.parametrize(
    "condition",
    ["URDF masses 0", "URDF masses 1 kg", "URDF masses 10 g", "motors left out"],
)
def test_link_masses_that_are_wrong_are_named_and_not_used(condition, tmp_path):
    cell = quiet_cell(condition)
    code, _, result = typed(cell, tmp_path)
    assert code == 0
    assert off(result, cell) < 2.0
    said = " ".join(finding["what"] for finding in warnings(result))
    assert "mass" in said or "link" in said


def test_link_without_mass_is_unknown_and_named(tmp_path):
    cell = quiet_cell("one link 0 kg")
    joint = int(np.flatnonzero(cell.stated.mass_kg == 0.0)[0]) + 1
    code, _, result = typed(cell, tmp_path)
    assert code == 0
    assert off(result, cell) < 2.0
    assert [f["where"] for f in result["findings"] if "unknown" in f["what"]] == [f"J{joint}"]


@pytest.mark.parametrize("condition", ["drift 4 %", "load changes halfway"])
def test_what_changes_over_the_run_is_not_passed_on_silently(condition, tmp_path):
    cell = quiet_cell(condition)
    _, _, result = typed(cell, tmp_path)
    assert warnings(result)
    assert condition != "drift 4 %" or off(result, cell) < 3.0


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("condition", ["known mass x0.7", "known mass x0.7, no centre"])
def test_known_mass_that_is_wrong_is_named_and_not_used(condition, command, tmp_path):
    cell = quiet_cell(condition)
    code, _, result = typed(cell, tmp_path, command)
    assert code == 0
    assert [(f["check"], f["where"]) for f in warnings(result)] == [("known_load", "load weight")]
    assert f"{0.7 * cell.loads['weight'][0]:.4g} kg" in warnings(result)[0]["what"]
    assert off(result, cell) < 2.0
    weight = next(load for load in result["loads"] if load["label"] == "weight")
    assert abs(weight["mass_kg"] - cell.loads["weight"][0]) < 2.0 * weight["mass_std_kg"]


def test_known_centre_that_is_wrong_is_named_and_not_used(tmp_path):
    cell = quiet_cell("known mass")
    mass, *centre = cell.loads["weight"]
    moved = ",".join(f"{x:.9g}" for x in (mass, centre[0] + 0.25 * cell.arm.rated_kg**0.34, *centre[1:]))
    cell.options[-1] = f"weight={moved}"
    code, _, result = typed(cell, tmp_path)
    assert code == 0
    assert [f["check"] for f in warnings(result)] == ["known_load"]
    assert "centre of gravity" in warnings(result)[0]["what"]
    assert off(result, cell) < 2.0


def exchanged(cell: ConflictCell) -> None:
    for kind in ("nm", "std_nm"):
        one, other = (f"tau{axis}_{kind}" for axis in (2, 3))
        cell.columns[one], cell.columns[other] = cell.columns[other], cell.columns[one]


def gripper_left(cell: ConflictCell) -> None:
    """A third of the tool's mass was on the flange in the unloaded run."""
    mass, *centre = cell.loads["tool"]
    cell.loads["gripper"] = np.array([mass / 3.0, *centre])
    for block in cell.blocks:
        if block.label == "none":
            block.load = "gripper"
    cell.columns = measure(cell)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("condition", "change", "cause"),
    [
        ("URDF masses x3", None, "torque_constants"),
        ("URDF of a larger size", None, "torque_constants"),
        ("known mass, constants x1.41", None, "torque_constants"),
        ("clean", exchanged, "axes_swapped"),
        ("clean", gripper_left, "body_in_unloaded_run"),
    ],
    ids=["masses x3", "another arm", "constants x1.41", "columns", "gripper"],
)
def test_a_large_contradiction_fails_with_its_causes_and_gives_no_narrow_load(
    command, condition, change, cause, tmp_path
):
    cell = quiet_cell(condition)
    if change is not None:
        change(cell)
    code, output, result = typed(cell, tmp_path, command)
    assert code == 7
    load = next(load for load in result["loads"] if load["label"] == "tool")
    failed = {finding["check"]: finding for finding in warnings(result) if finding["severity"] == "fail"}
    if load["mass_kg"] is not None:  # a diagnosis corrects exchanged columns
        assert (command, cause) == ("diagnose", "axes_swapped")
        assert off(result, cell) < 3.0
        return
    assert load["refused"]
    advice = failed[cause]["advice"]
    assert all(f"({number})" in advice for number in (1, 2, 3, 4))
    assert {"axes_swapped": "exchanged", "torque_constants": "unit", "body_in_unloaded_run": "a body"}[
        cause
    ] in advice.split("(2)")[0]
    assert "Traceback" not in output


@pytest.mark.parametrize("option", ["inertials exact", "torque-gain exact"])
def test_exact_is_tested_like_any_other_statement(option, tmp_path):
    cell = draw_cell(7)  # its links scatter by 5 %, its constants by 3 %
    CONDITIONS[option].before(cell)
    cell.columns = measure(cell)
    _, _, result = typed(cell, tmp_path)
    assert warnings(result) or off(result, cell) < 3.0


@pytest.mark.parametrize("command", COMMANDS)
def test_joint_counted_in_the_other_direction_is_named(command, tmp_path):
    cell = quiet_cell("joint counted in reverse")
    joint = changed_axis(cell, quiet_cell().columns)
    _, _, result = typed(cell, tmp_path, command)
    assert f"J{joint}" in {finding["where"] for finding in warnings(result)}


@pytest.mark.parametrize("command", COMMANDS)
def test_coupled_angles_are_not_passed_on_silently(command, tmp_path):
    cell = quiet_cell("q3 holds q3 + q2")
    _, _, result = typed(cell, tmp_path, command)
    assert warnings(result)
    if command == "diagnose":
        assert [(effect["name"], effect["joints"]) for effect in result["effects"]] == [("angles_coupled", [2, 3])]
        assert off(result, cell) < 2.0


@pytest.mark.parametrize(
    ("condition", "source"),
    [("clean", None), ("joint zeros 0.5 deg", "zeros"), ("hose with the load", "cable")],
)
def test_zero_errors_and_hoses_are_in_the_interval_of_the_centre_and_in_the_budget(condition, source, tmp_path):
    cell = quiet_cell(condition)
    _, _, result = typed(cell, tmp_path)
    load = next(load for load in result["loads"] if load["label"] == "tool")
    disturbed = {name for name in ("zeros", "cable") if load["budget"][name] > 0.01}
    assert disturbed == ({source} if source else set())
    away = np.abs(np.array(load["com_m"]) - cell.loads["tool"][1:]) / np.array(load["com_std_m"])
    assert (away < 3.0).all()


@pytest.mark.parametrize("command", COMMANDS)
def test_gravity_that_is_upside_down_is_named(command, tmp_path):
    code, _, result = typed(quiet_cell("gravity upside down"), tmp_path, command)
    assert code == 7
    assert result["loads"][0]["mass_kg"] is None
    assert "gravity_reversed" in {finding["check"] for finding in warnings(result) if "check" in finding}


def test_reversed_signs_of_all_axes_are_not_called_gravity(tmp_path):
    code, _, result = typed(quiet_cell("torque sign, all"), tmp_path)
    assert code == 7
    assert result["loads"][0]["mass_kg"] is None
    checks = {finding.get("check") for finding in warnings(result)}
    assert "sign_reversed" in checks
    assert "gravity_reversed" not in checks


@pytest.mark.slow
def test_zero_of_another_convention_is_named_and_undone(tmp_path):
    cell = quiet_cell("zero convention")
    plain = quiet_cell().columns
    joint = next(axis for axis in range(1, 7) if (cell.columns[f"q{axis}_rad"] != plain[f"q{axis}_rad"]).any())
    _, _, result = typed(cell, tmp_path, "diagnose")
    assert [(effect["name"], effect["joints"]) for effect in result["effects"]] == [("zero_convention", [joint])]
    turned = plain[f"q{joint}_rad"][0] - cell.columns[f"q{joint}_rad"][0]
    assert np.cos(result["effects"][0]["parameters"]["offset_rad"] - turned) == pytest.approx(1.0)
    assert off(result, cell) < 2.0


def test_currents_as_torques_are_refused_with_their_unit(tmp_path):
    code, output, result = typed(quiet_cell("current as torque"), tmp_path)
    assert code in (3, 7)
    assert all(load["mass_kg"] is None for load in result["loads"])
    assert "currents in A" in output + " ".join(finding["what"] for finding in result["findings"])
