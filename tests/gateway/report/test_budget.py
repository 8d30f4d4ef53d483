"""Where a mass's uncertainty comes from, as picture and as numbers; nuisances and what was rejected as tables."""

import re
from dataclasses import replace

import pytest

from gateway.report.budget import budget_figure, budget_rows, nuisance_rows, rejected_rows
from gateway.report.render import render
from gateway.result.result import LoadResult, NuisanceResult, Result, SetAside

NAN = float("nan")
BUDGET = {"constants": 0.64, "links": 0.04, "friction": 0.0, "drift": 0.0, "zeros": 0.0, "cable": 0.0, "noise": 0.32}
LOAD = LoadResult("tool", 10.0, 0.5, (0.0, 0.0, 0.1), (0.01, 0.01, 0.01), "link_6", budget=BUDGET)


def widths(picture: str) -> dict[str, float]:
    found = re.findall(r'class="source-(\w+)" x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', picture)
    return {name: float(width) for name, _, width in found}


def test_a_bar_is_cut_by_the_shares():
    drawn = widths(budget_figure(Result("r", (LOAD,))))
    total = sum(drawn.values())
    assert {name: width / total for name, width in drawn.items()} == pytest.approx(BUDGET, abs=1e-3)


def test_numbers_are_inside_only_where_there_is_space():
    picture = budget_figure(Result("r", (LOAD,)))
    assert re.findall(r">(\d+ %)</text>", picture) == ["64 %", "32 %"]
    assert "torque constants 64 %, links 4 %, friction 0 %, drift of the torque readings 0 %, zero errors" in picture
    assert "noise 32 %" in picture


def test_bars_of_several_loads_stand_apart():
    picture = budget_figure(Result("r", (LOAD, replace(LOAD, label="other"))))
    tops = sorted({float(y) for y in re.findall(r'class="source-\w+" x="[\d.]+" y="([\d.]+)"', picture)})
    assert tops[1] - tops[0] > 40
    assert "load \N{LEFT DOUBLE QUOTATION MARK}other" in picture


def test_parts_add_up_in_squares():
    (row,) = budget_rows(Result("r", (LOAD,)))
    # 1.96 * 0.5, and the roots of the shares of it
    assert row[1] == "0.98"
    assert [part[2] for part in row[2]] == ["0.78", "0.20", "0.00", "0.00", "0.00", "0.00", "0.55"]


@pytest.mark.parametrize(
    "load", [replace(LOAD, budget={}), replace(LOAD, mass_std_kg=NAN), replace(LOAD, mass_std_kg=0.0)]
)
def test_no_picture_where_nothing_is_known(load):
    assert budget_figure(Result("r", (load,))) is None


def test_nuisances_carry_their_unit_and_interval():
    result = Result(
        "r", nuisance={"gain": NuisanceResult((0.012, NAN), (0.02, NAN)), "other_nm": NuisanceResult((1.0,), (0.5,))}
    )
    assert nuisance_rows(result) == [
        ("gain of the torque [%]", ["1.2 \N{PLUS-MINUS SIGN} 3.9", "\N{EN DASH}"]),
        ("other [Nm]", ["1.00 \N{PLUS-MINUS SIGN} 0.98"]),
    ]


def test_the_page_lists_rejected_visits():
    entries = (
        SetAside("a", "tool", 2, 5.25, pose=3, reason="as if a brake had held"),
        SetAside("b", "none", 1, NAN, from_s=1.0, to_s=2.5, reason="far off"),
    )
    assert [row[2:5] for row in rejected_rows(entries)] == [
        ("pose 3", "J2", "5.2"),
        ("1.0 to 2.5 s", "J1", "\N{EN DASH}"),
    ]
    page = render(Result("r", (LOAD,), set_aside=entries))
    assert "as if a brake had held" in page
    assert "Sources of the uncertainty of the mass" in page
