"""Every page by the same shell: one file, offline, well formed, every axis with its unit."""

import html.parser
import json
import math
import re

import pytest

from gateway.report.follow import headline, render_follow
from gateway.report.pair import FORCE, GAP, Limited, render_pair
from gateway.report.render import render
from gateway.result.follow import (
    AxisSources,
    ErrorCurve,
    FedLoad,
    FedModel,
    FedTrend,
    FollowedPath,
    FollowedSetting,
    FollowResult,
    FollowSeries,
    PeakRatio,
    TorqueCurve,
    TrendCloud,
)
from gateway.result.pair import CycleSummary, PairRunResult
from gateway.result.result import from_json

VOID = {"meta", "link", "br", "img", "input", "hr"}
SIX = (0.0157, 0.0167, 0.0167, 0.0176, 0.0228, 0.0317)
EVIL = "<script>alert(1)</script>"


class Balanced(html.parser.HTMLParser):
    """Fails on a tag that is closed out of turn."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open
        assert self.open.pop() == tag


def comparison(robot="qh165"):
    load = FedLoad("tool", 69.9, 0.1, (0.05, -0.02, 0.22), "link_6", ((1.0, 0.0, 0.0),) * 3, "r.json", "assumed")
    scaled = {"off": 1.0, "maximum": 0.1, "identified": 0.01}
    return FollowResult(
        robot=robot,
        cell="large",
        arm="main",
        path=FollowedPath("swing", "path.toml", 7.7, 0.004),
        settings=tuple(
            FollowedSetting(name, None if name == "off" else load, *(tuple(k * v for v in SIX),) * 4)
            for name, k in scaled.items()
        ),
        ratio=PeakRatio({}, None),
        trend=FedTrend(0.2, 0.01, 83.0, 1.0, (0.05, -0.02, 0.22), (0.01, 0.01, 0.01), SIX),
        model=FedModel("robot model", (AxisSources("assumed", "assumed", "assumed", "assumed", "1"),) * 6),
        computing_s=None,
        left_out_syncs=0,
        findings=(),
        series=FollowSeries(
            {name: ErrorCurve((0.0, 1.0, 2.0), ((0.0, math.nan, k * 0.01),) * 6) for name, k in scaled.items()},
            (TorqueCurve(2, (0.0, 1.0), (3.0, math.nan), (3.0, 4.0)),),
            (TrendCloud(2, (700.0, 900.0), (140.0, 180.0)),),
        ),
    )


def run(name="C8", **along):
    cycles = tuple(
        CycleSummary(cycle=number, knots=9 + number, force_n=60.0 / number, moment_nm=2.0, gap_m=3e-4 / number)
        for number in (1, 2, 3)
    )
    return PairRunResult(
        name=name, text="learned on the run", speed=1.5, s_m=(0.0, 0.5), x_m=(0.7, 0.9), knots_s_m=(0.0,),
        cycles=cycles, **along,
    )  # fmt: skip


def forces(name="C8"):
    return render_pair(
        "pair", Limited(FORCE, 40.0, "as estimated"), [run(name, first_n=(0.0, 60.0), last_n=(0.0, 20.0))]
    )


@pytest.fixture(scope="module", params=["result", "comparison", "force", "gap"])
def page(request, full_result):
    if request.param == "result":
        return render(from_json(json.dumps(full_result)))
    if request.param == "comparison":
        return render_follow(comparison())
    if request.param == "force":
        return forces()
    return render_pair("gap", Limited(GAP, 1e-3, "as measured"), [run(first_m=(0.0, 3e-4), last_m=(0.0, math.nan))])


def test_a_page_is_one_small_file_that_fetches_nothing(page):
    assert page.startswith("<!DOCTYPE html>")
    assert not re.search(r"""(src|href)\s*=|url\(|@import|<script|https?://""", page)
    assert len(page) < 6e6


def test_a_page_is_well_formed_and_has_head_and_foot(page):
    parser = Balanced()
    parser.feed(page)
    assert parser.open == []
    assert page.count('<header class="top">') == page.count("<footer") == page.count('<section class="verdict') == 1


def test_every_axis_of_every_drawing_is_labelled_with_its_unit(page):
    labels = re.findall(r'class="label mid"[^>]*>([^<]+)<', page)
    bare = [label for label in labels if not re.search(r"\[(Nm|N|mm|kg|m?rad|s|m|number|-)\]", label)]
    named = {"noise floor", "no better than without", "cycle"}
    assert len(labels) >= 6
    assert all(label in named or re.search(r"poses?$", label) for label in bare)


def test_a_number_that_is_not_known_is_never_shown(page):
    assert not re.search(r"\b(nan|None|inf)\b", re.sub(r"<style>.*?</style>", "", page, flags=re.S))


def test_the_headline_of_a_comparison_goes_from_setting_to_setting():
    assert headline(comparison()) == "Peak following error: J2 16.7 > 1.67 > 0.167 mrad; J3 16.7 > 1.67 > 0.167 mrad"


def test_a_comparison_has_three_drawings_an_axis_on_one_scale():
    page = render_follow(comparison())
    assert page.count('class="three"') == 6
    assert page.count("<svg") == 1 + 18 + 6 + 1 + 1


def test_words_from_the_data_stay_words():
    assert "<script" not in render_follow(comparison(EVIL))
    assert "<script" not in forces(EVIL)


def test_a_pair_whose_last_cycle_is_inside_the_limit_is_good():
    page = forces()
    assert 'class="verdict good"' in page
    assert "C8: largest force 20 N in the last cycle" in page
    for text in ("Fx [N]", "way along the path [m]", "largest force [N]", "figure 19"):
        assert text in page
