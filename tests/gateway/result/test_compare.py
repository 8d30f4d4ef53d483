"""Before and after service: changed, unchanged, cannot tell, with the uncertainty of both results."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gateway.errors import InputError
from gateway.report.comparison_page import compared_cells, render_compare
from gateway.result.compare import compare, parse_tolerance, sentence
from gateway.result.result import from_json

NAMES = ("a.json", "b.json")


def result(mass=(5.0, 0.02), com=(0.0, 0.0, 0.1), com_std=0.001, gain=None, band=None, **more):
    """A result with one load, torque constants and friction where they are given."""
    load = {
        "label": "tool",
        "mass_kg": mass[0],
        "mass_std_kg": mass[1],
        "com_m": list(com),
        "com_std_m": [com_std] * 3,
        "frame": "link_6",
    }
    body = {"schema": 1, "robot": "small", "loads": [load], **more}
    if gain is not None:
        response = gain[2] if len(gain) > 2 else [1.0] * 6
        body["nuisance"] = {"gain": {"value": list(gain[0]), "std": list(gain[1]), "response": response}}
        body["provenance"] = {
            f"J{joint}": {"torque_constant": {"value": 0.3, "unit": "Nm/A", "source": "datasheet p. 2"}}
            for joint in range(1, 7)
        }
    if band is not None:
        rows = np.asarray(band)
        body["friction_band_nm"] = np.median(rows, axis=0).tolist()
        count = len(rows)
        body["rows"] = {
            "run": ["r"] * count,
            "load": ["tool"] * count,
            "pose": list(range(count)),
            "time_s": [0.0] * count,
            "q_rad": [[0.0] * 6] * count,
            "direction": [[0] * 6] * count,
            "tau_nm": [[0.0] * 6] * count,
            "model_nm": [[0.0] * 6] * count,
            "band_nm": rows.tolist(),
            "std_nm": [[0.1] * 6] * count,
        }
    return from_json(json.dumps(body))


def verdict(one, other, tolerance=""):
    found = compare(one, other, NAMES, parse_tolerance(tolerance) if tolerance else {})
    return found.verdict, {(row.where, row.what): row.outcome for row in found.quantities}


def test_the_same_within_its_uncertainty_is_unchanged():
    said, rows = verdict(result(), result(mass=(5.01, 0.02)))
    assert said == "unchanged"
    assert set(rows.values()) == {"unchanged"}


def test_a_significant_difference_is_a_change():
    said, rows = verdict(result(), result(mass=(5.3, 0.02)))
    assert said == "changed"
    assert [key for key, outcome in rows.items() if outcome == "changed"] == [("load tool", "mass")]


def test_a_difference_inside_a_wide_uncertainty_is_undecided():
    assert verdict(result(mass=(5.0, 0.5)), result(mass=(5.3, 0.5)))[0] == "cannot tell"


@pytest.mark.parametrize(
    ("tolerance", "said"), [("mass=20%,com=9mm", "unchanged"), ("mass=0.1kg", "changed"), ("mass=310g", "cannot tell")]
)
def test_a_stated_tolerance_decides(tolerance, said):
    assert verdict(result(), result(mass=(5.3, 0.02)), tolerance)[0] == said


def test_a_torque_constant_that_changed_is_named_in_its_unit():
    # readings 5 % too large after the service: the motor gives 0.3 / 1.05 Nm/A
    before = result(gain=([0.0] * 6, [0.005] * 6))
    after = result(gain=([0.0, 0.05, 0.0, 0.0, 0.0, 0.0], [0.005] * 6))
    found = compare(before, after, NAMES, {})
    changed = [row for row in found.quantities if row.outcome == "changed"]
    assert [(row.where, row.what, row.unit) for row in changed] == [("J2", "torque constant", "Nm/A")]
    assert changed[0].before == pytest.approx(0.3)
    assert changed[0].after == pytest.approx(0.3 / 1.05)
    assert changed[0].after_std == pytest.approx(0.3 / 1.05**2 * 0.005)
    assert "J2" in sentence(found)


def test_a_constant_that_an_effect_corrected_counts_too():
    effect = {"name": "torque_constant_scale", "joints": [3], "parameters": {"scale": 0.9}, "std": {"scale": 0.004}}
    gain = ([0.0] * 6, [0.004] * 6)
    found = compare(result(gain=gain), result(gain=gain, effects=[effect]), NAMES, {})
    assert [row.where for row in found.quantities if row.outcome == "changed"] == ["J3"]


def test_friction_is_compared_by_the_scatter_of_its_bands():
    rng = np.random.default_rng(3)
    old, worn = (rng.normal(level, 0.2, (40, 6)) for level in (4.0, 4.0))
    worn[:, 3] += 3.0
    found = compare(result(band=old), result(band=worn), NAMES, {})
    changed = [(row.where, row.what) for row in found.quantities if row.outcome == "changed"]
    assert changed == [("J4", "friction band")]


def test_friction_that_scatters_from_start_to_start_did_not_change():
    """Ten per cent from one start to the next: of 100 pairs one in twenty may be reported."""
    rng = np.random.default_rng(5)
    level = 4.0 * (1.0 + 0.1 * rng.standard_normal((200, 6)))
    days = [result(band=day + rng.normal(0.0, 0.05, (12, 6))) for day in level]
    alarms = sum(compare(*pair, NAMES, {}).verdict == "changed" for pair in zip(days[::2], days[1::2], strict=True))
    assert alarms <= 100 * 0.05 + 3 * math.sqrt(100 * 0.05 * 0.95)


def test_errors_that_both_results_share_are_not_in_the_difference():
    """Of 0.5 kg each, 0.48 kg is one error: s^2 = 2 (0.25 - 0.2304), and z = 2.50 for four quantities: 0.495 kg."""

    def shared(mass_kg, error_kg):
        made = result(mass=(mass_kg, 0.5))
        errors = {"gain": ((error_kg,), (0.0,), (0.0,), (0.0,))}
        return replace(made, loads=(replace(made.loads[0], common_errors=errors),))

    found = compare(shared(5.0, 0.48), shared(5.6, 0.48), NAMES, {})
    assert found.quantities[0].half_width == pytest.approx(2.4977 * math.sqrt(2 * (0.25 - 0.48**2)), rel=1e-3)
    assert found.quantities[0].outcome == "changed"
    assert compare(shared(5.0, 0.48), shared(5.6, 0.0), NAMES, {}).quantities[0].outcome == "cannot tell"


def test_a_constant_that_only_its_prior_determines_cannot_be_compared():
    """J1: nothing measured. J2: values follow half of a change, so a difference of 4 % is one of 8 %."""
    response = [0.1, 0.5, 1.0, 1.0, 1.0, 1.0]
    before = result(gain=([0.0] * 6, [0.001] * 6, response))
    after = result(gain=([0.0, -0.04, -0.04, 0.0, 0.0, 0.0], [0.001] * 6, response))
    found = compare(before, after, NAMES, parse_tolerance("constant=5%,mass=5%,com=9mm"))
    outcomes = {row.where: row.outcome for row in found.quantities if row.what == "torque constant"}
    assert (outcomes["J1"], outcomes["J2"], outcomes["J3"]) == ("cannot tell", "changed", "unchanged")
    assert any("J1 torque constant: not measured" in remark for remark in found.remarks)


def test_a_quantity_without_uncertainty_is_shown_and_decides_nothing():
    other = result(friction_band_nm=[4.0] * 6)
    found = compare(result(friction_band_nm=[2.0] * 6), other, NAMES, {})
    assert {row.outcome for row in found.quantities if row.what == "friction band"} == {"cannot tell"}
    assert found.verdict == "unchanged"


def test_one_false_alarm_in_twenty_over_all_quantities():
    """200 pairs of results without a change, each of 6 constants and 4 load quantities with their stated scatter."""
    rng = np.random.default_rng(7)
    alarms = 0
    for _ in range(200):
        pair = [
            result(
                mass=(5.0 + rng.normal(0, 0.02), 0.02),
                com=rng.normal([0, 0, 0.1], 0.001).tolist(),
                gain=(rng.normal(0, 0.005, 6).tolist(), [0.005] * 6),
            )
            for _ in range(2)
        ]
        alarms += compare(pair[0], pair[1], NAMES, {}).verdict == "changed"
    assert alarms <= 200 * 0.05 + 3 * math.sqrt(200 * 0.05 * 0.95)


def test_other_robots_and_results_without_a_common_quantity_are_refused():
    with pytest.raises(InputError, match="robot 'small'.*robot 'other'"):
        compare(result(), result(robot="other"), NAMES, {})
    bare = from_json(json.dumps({"schema": 1, "robot": "small", "loads": []}))
    with pytest.raises(InputError, match="no quantity in common"):
        compare(result(), bare, NAMES, {})


def test_what_only_one_holds_is_remarked():
    found = compare(result(gain=([0.0] * 6, [0.01] * 6)), result(), NAMES, {})
    assert "J1 torque constant: only in a.json" in found.remarks


@pytest.mark.parametrize("text", ["mass", "mass=2", "mass=-1%", "com=2%", "speed=1%", "5"])
def test_a_tolerance_without_key_or_unit_is_refused(text):
    with pytest.raises(InputError, match="such as mass=2%"):
        parse_tolerance(text)


def test_a_share_alone_is_that_of_all_that_have_one():
    assert set(parse_tolerance("5%")) == {"mass", "constant", "friction"}


def test_the_page_holds_every_quantity_and_the_verdict():
    found = compare(
        result(gain=([0.0] * 6, [0.01] * 6)), result(mass=(5.3, 0.02), gain=([0.0] * 6, [0.01] * 6)), NAMES, {}
    )
    page = render_compare(found)
    assert sentence(found) in page
    centre = replace(found.quantities[1], after=found.quantities[1].before + 0.002, half_width=math.nan)
    assert compared_cells(centre)[4].startswith("2"), "mm also without an interval"
    assert page.count('<span class="tag') == len(found.quantities)
    assert "<svg" in page
    assert "http" not in page.replace("http://www.w3.org", "")
