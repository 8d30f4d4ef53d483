"""Numbers and sentences of the report."""

import json
import math

import pytest

from gateway.report.view import view
from gateway.result.acceptance import Expected, accepted
from gateway.result.result import from_json


def read(body):
    """The result that a file of this content holds."""
    return from_json(json.dumps(body))


def test_the_first_screen_answers_what_how_accurate_how_good_and_what_was_wrong(result):
    shown = view(read(result))
    assert shown["headline"] == (
        "25.03 ± 0.22 kg (95 %) of load “tool” and 71.22 ± 0.31 kg (95 %) of load “tool+part” on the flange"
    )
    assert shown["verdict"].startswith("The model lacked a balancer spring on J2.")
    assert "1.1 times the noise floor on the worst axis, J1" in shown["quality"]
    assert shown["status"] == "good"


def test_a_statement_that_the_measurement_contradicts_is_amber(result):
    result["findings"] = [{"severity": "warn", "where": "J2", "what": "the link masses are contradicted"}]
    assert view(read(result))["status"] == "open"


def test_half_widths_are_95_percent_intervals(result):
    load = view(read(result))["loads"][0]
    # 25.03 -+ 1.96 * 0.11
    assert (load["mass"], load["mass_half"], load["interval"]) == ("25.03", "0.22", "24.81 to 25.25 kg")
    assert (load["before_mass"], load["before_half"]) == ("27.9", "1.8")
    assert [(part["name"], part["value"], part["before"]) for part in load["com"]] == [
        ("x", "12.1", "19.0"),
        ("y", "\N{MINUS SIGN}3.4", "\N{MINUS SIGN}4.0"),
        ("z", "180.0", "166.0"),
    ]
    assert load["frame"] == "flange"


def test_without_a_flange_the_centre_of_gravity_is_in_link_6(result):
    del result["loads"][0]["com_flange_m"]
    load = view(read(result))["loads"][0]
    assert load["frame"] == "link_6"
    assert load["com"][2]["value"] == "280.0"


@pytest.mark.parametrize(
    ("verdict", "says", "status"),
    [
        ("none_needed", "The model is complete", "good"),
        ("improved", "Part of the error remains", "open"),
        ("unexplained", "not in the library", "open"),
        ("undecided", "cannot decide", "open"),
        (None, "without a diagnosis", "open"),
    ],
)
def test_every_verdict_has_its_text(result, verdict, says, status):
    result["verdict"] = verdict
    result["effects"].append({"name": "base_tilt", "joints": []})
    shown = view(read(result))
    assert says in shown["verdict"]
    assert shown["status"] == status


def test_what_further_poses_decided_is_said_with_each_candidate(result):
    candidates = [{"name": "joint_zero_offset", "joints": [joint]} for joint in (2, 3)]
    result["decided"] = {"effects": candidates, "poses": 8}
    said = view(read(result))["verdict"]
    assert "8 further poses" in said
    assert "on J2 and" in said
    assert said.endswith("on J3.")
    result["decided"]["effects"].pop()
    assert view(read(result))["verdict"].endswith("on J2 and nothing at all.")


def test_undecided_without_effects_says_there_is_too_little_data(result):
    result |= {"verdict": "undecided", "effects": []}
    assert "too little data" in view(read(result))["verdict"]


def test_undecided_names_what_cannot_be_distinguished(result):
    result["verdict"] = "undecided"
    result["effects"].append({"name": "base_tilt", "joints": []})
    assert "between a balancer spring on J2 and a tilted base" in view(read(result))["verdict"]


def test_a_refused_load_turns_the_page_red(result):
    result["loads"][1] |= {"mass_kg": None, "refused": "rows 9 and 10 have the wrong sign"}
    shown = view(read(result))
    assert shown["status"] == "bad"
    assert shown["headline"] == "25.03 ± 0.22 kg (95 %) of load “tool” on the flange; tool+part refused"
    assert shown["loads"][1]["refused"].startswith("rows 9")


def test_an_axis_that_was_not_measured_stays_unknown(result):
    for key in ("rms_nm", "holdout_rms_nm"):
        result["after"][key][0] = result["before"][key][0] = None
    shown = view(read(result))
    assert math.isnan(shown["axes"][0].after)
    assert math.isnan(shown["axes"][0].ratio_after)
    assert "worst axis, J5" in shown["quality"]


def test_a_load_that_may_not_be_mounted_is_asked_for_and_never_green(result):
    result |= {"verdict": "none_needed", "effects": [], "loads": [result["loads"][0]]}
    result["loads"][0] |= {"mass_kg": 0.004, "mass_std_kg": 0.006}
    shown = view(read(result))
    assert shown["headline"] == "0.004 ± 0.012 kg (95 %): no load detected. Is it mounted?"
    assert shown["verdict"].startswith("The torque is that of an unloaded arm")
    assert shown["status"] == "open"
    result["loads"][0] |= {"mass_kg": 0.013}
    assert view(read(result))["status"] == "good"


@pytest.mark.parametrize(("tolerance", "status", "says"), [(0.3, "good", "pass"), (0.2, "open", "cannot tell")])
def test_what_the_data_cannot_determine_is_amber(result, tolerance, status, says):
    """25.03 kg, known to 0.216 kg."""
    judged = accepted(read(result), [Expected("tool", 25.0, tolerance)], ())
    shown = view(judged)
    assert shown["status"] == status
    assert says in shown["acceptance"][0][1]
    assert "25.03 ± 0.22 kg (95 %)" in shown["acceptance"][0][2]
    assert view(accepted(read(result), [Expected("tool", 24.0, tolerance)], ()))["status"] == "bad"


def test_a_component_that_is_not_identifiable_is_unknown_not_zero(result):
    result["loads"][0]["com_flange_m"] = [0.01, None, 0.1]
    result["loads"][0]["unidentifiable"] = ["com_y: gravity never leaves the x-z plane of the tool"]
    load = view(read(result))["loads"][0]
    assert load["com"][1]["value"] == "unknown"
    assert load["unidentifiable"] == ("com_y: gravity never leaves the x-z plane of the tool",)


def test_candidates_chosen_first_then_by_their_held_out_error(result):
    labels = [(item.label, item.chosen) for item in view(read(result))["candidates"]]
    assert labels[0] == ("balancer spring J2", True)
    assert labels[1] == ("torque constant scale J2", False)
    assert labels[-1] == ("torque offset J2", False)


def test_parameters_carry_their_unit(result):
    effect = view(read(result))["effects"][0]
    # 84210, 1.96 * 1900
    assert effect["parameters"][0] == ("stiffness of the spring, if it has the reach below", "84200", "3700", "N/m")
    assert effect["parameters"][1][3] == "m"
    assert "next best candidate: a wrong torque constant" in effect["evidence"][-1]


def test_an_effect_on_several_axes_is_named_once(result):
    result["effects"] = [{"name": "velocity_friction", "joints": [joint]} for joint in (3, 1, 4)]
    assert "friction that changes with speed on J1, J3 and J4" in view(read(result))["verdict"]
