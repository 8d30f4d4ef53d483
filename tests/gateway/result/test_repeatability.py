"""Repeated measurements: spread over what the stated deviations predict, with errors that all repetitions share."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.errors import InputError
from gateway.report.comparison_page import render_repeatability
from gateway.result.repeatability import conclusion, repeatability
from gateway.result.result import from_json, to_json

OWN_KG, SHARED_KG = 0.03, 0.1


def repeated(masses, shared=(SHARED_KG,), own=OWN_KG, common=True, **more):
    """Results of one load; each stated deviation has an own part and a shared part that changes a little by pose."""
    shared = np.resize(shared, len(masses))
    return [
        from_json(json.dumps(body(mass, float(np.hypot(own, part)), float(part) if common else None, **more)))
        for mass, part in zip(masses, shared, strict=True)
    ]


def body(mass_kg, std_kg, part_kg, **more):
    load = {"label": "tool", "mass_kg": float(mass_kg), "mass_std_kg": std_kg}
    if part_kg is not None:
        load["common_errors"] = {"gain": [[part_kg, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]}
    return {"schema": 1, "robot": "small", "loads": [load], **more}


def judged(results):
    return repeatability(results, [f"{number}.json" for number in range(1, len(results) + 1)])


def drawn(rng, count=20, own=OWN_KG):
    """Masses whose true error agrees with `repeated`: one shared draw, other sensitivities, own errors."""
    shared = SHARED_KG * rng.uniform(0.8, 1.2, count)
    return 5.0 + shared * rng.standard_normal() + own * rng.standard_normal(count), shared


def test_intervals_hold_a_ratio_of_one_and_false_verdicts_are_rare():
    rng = np.random.default_rng(3)
    rows = [judged(repeated(*drawn(rng))).quantities[0] for _ in range(300)]
    # 95 % of 300 with four standard deviations of a share
    assert np.mean([row.low < 1.0 < row.high for row in rows]) > 0.90
    assert np.mean([row.outcome in ("too small", "too large") for row in rows]) < 0.10
    assert np.sqrt(np.mean([row.ratio**2 for row in rows])) == pytest.approx(1.0, abs=0.05)
    assert np.mean([row.spread / row.stated for row in rows]) < 0.5, "the plain ratio would prove nothing"


def test_equal_shared_errors_leave_the_chi_square_of_the_own_part():
    masses = 5.0 + OWN_KG * np.resize([1.0, -1.0], 20)
    (row,) = judged(repeated(masses)).quantities
    spread = OWN_KG * np.sqrt(20.0 / 19.0)
    assert row.expected == pytest.approx(OWN_KG)
    assert row.ratio == pytest.approx(spread / OWN_KG)
    # chi-square with 19 degrees of freedom: quantiles 8.907 and 32.852 (ISO 2854, table)
    assert row.low == pytest.approx(row.ratio * np.sqrt(19.0 / 32.852), rel=1e-4)
    assert row.high == pytest.approx(row.ratio * np.sqrt(19.0 / 8.907), rel=1e-4)
    assert row.mean_std == pytest.approx(np.hypot(OWN_KG / np.sqrt(20.0), SHARED_KG))
    assert row.outcome == "hold"


def test_a_spread_that_is_too_wide_is_named_with_what_to_do():
    found = judged(repeated(*drawn(np.random.default_rng(4), own=2.5 * OWN_KG)))
    assert found.verdict == "too small"
    assert "mass of load tool" in conclusion(found)
    assert "mounting" in found.remarks[0]


def test_a_spread_that_is_too_narrow_is_cautious():
    assert judged(repeated(*drawn(np.random.default_rng(5), own=0.2 * OWN_KG))).verdict == "too large"


def test_without_shared_errors_a_small_spread_proves_nothing():
    masses, shared = drawn(np.random.default_rng(6))
    found = judged(repeated(masses, shared, common=False))
    assert found.verdict == "cannot tell"
    assert any("small ratio proves nothing" in remark for remark in found.remarks)


def test_a_measurement_that_is_far_away_is_listed():
    masses = 5.0 + 0.3 * OWN_KG * np.resize([1.0, -1.0], 20)
    masses[6] += 4.0 * OWN_KG
    found = judged(repeated(masses))
    assert found.quantities[0].far == (7,)
    assert any(
        remark.startswith("7.json deviates from the mean: mass of load tool by +4.2") for remark in found.remarks
    )


def test_two_repetitions_are_too_few():
    found = judged(repeated([5.0, 5.03]))
    assert found.verdict == "cannot tell"
    assert "2 repetitions" in conclusion(found)


def test_a_refused_load_is_left_out_and_reported():
    results = repeated([5.0, 5.01, 5.02])
    nothing = {"label": "tool", "mass_kg": None, "refused": "rows contradict each other"}
    results[1] = from_json(json.dumps({"schema": 1, "robot": "small", "loads": [nothing]}))
    found = judged(results)
    assert found.quantities[0].repetition == (1, 3)
    assert "load tool: no mass in 2.json" in found.remarks


def test_the_same_poses_are_a_remark():
    rows = {"run": ["r"], "load": ["tool"], "pose": [1], "time_s": [0.0], "q_rad": [[0.1] * 6]}
    rows |= {name: [[0.0] * 6] for name in ("tau_nm", "model_nm", "band_nm", "std_nm")} | {"direction": [[0] * 6]}
    assert any("same poses" in remark for remark in judged(repeated([5.0, 5.01], rows=rows)).remarks)
    assert not any("same poses" in remark for remark in judged(repeated([5.0, 5.01])).remarks)


def test_what_is_no_series_is_refused():
    (one,) = repeated([5.0])
    with pytest.raises(InputError, match="at least 2 repetitions"):
        judged([one])
    with pytest.raises(InputError, match="only results of one arm"):
        judged([one, from_json(json.dumps(body(5.0, 0.1, 0.1) | {"robot": "large"}))])
    rows = {"fit": {"tool": {"q_rad": [[0.1] * 6], "tau_nm": [[3.0] * 6]}}}
    for same in ([from_json(to_json(one))] * 2, repeated([5.0, 5.1], data_roles=rows)):
        with pytest.raises(InputError, match=r"1\.json and 2\.json are of the same data"):
            judged(same)


def test_the_command_writes_page_and_json_and_fails_where_deviations_are_too_small(tmp_path):
    def run(own, *more):
        masses, shared = drawn(np.random.default_rng(7), own=own)
        files = [tmp_path / f"{number}.json" for number in range(1, 21)]
        for file, result in zip(files, repeated(masses, shared), strict=True):
            file.write_text(to_json(result), encoding="utf-8")
        return CliRunner().invoke(main, ["compare", *map(str, files), *more])

    page, answer = tmp_path / "page.html", tmp_path / "answer.json"
    done = run(OWN_KG, "--repeated", "-o", str(page), "--json", str(answer))
    assert done.exit_code == 0, done.output
    assert "the stated standard deviations hold" in done.stdout
    stored = json.loads(answer.read_text(encoding="utf-8"))
    assert (stored["kind"], stored["verdict"], stored["schema"]) == ("repeatability", "hold", 1)
    assert stored["quantities"][0]["beyond_3_std"] == []
    text = page.read_text(encoding="utf-8")
    assert text.count("<circle") == 20
    assert stored["conclusion"] in text
    assert run(3.0 * OWN_KG, "--repeated").exit_code == 7
    assert "with --repeated" in run(OWN_KG).stderr
    assert run(OWN_KG, "--repeated", "--tolerance", "mass=2%").exit_code == 2


def test_the_page_separates_days():
    results = [
        from_json(json.dumps(body(5.0 + 0.01 * k, 0.1, 0.09, data={"created": f"2026-03-0{1 + k // 2} 10:0{k} UTC"})))
        for k in range(4)
    ]
    text = render_repeatability(judged(results))
    assert text.count('class="group"') == 2
    assert "2026-03-02" in text
