"""Every page by the same shell: one file, offline, well formed, every axis with its unit."""

import html.parser
import json
import re
from dataclasses import replace

import pytest

from gateway.commands.console import Session
from gateway.commands.follow_command import _show
from gateway.report.follow_page import figure_rows, headline, render_follow
from gateway.report.pair_page import FORCE, Limited, render_pair
from gateway.report.render import render
from gateway.result.origin import FileOrigin, Origin, drives_of
from gateway.result.result import from_json
from tests.support.pages.other import comparison, forces, gaps, run

VOID = {"meta", "link", "br", "img", "input", "hr"}
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


@pytest.fixture(scope="module", params=["result", "comparison", "force", "gap"])
def page(request, full_result):
    if request.param == "result":
        return render(from_json(json.dumps(full_result)))
    if request.param == "comparison":
        return render_follow(comparison())
    if request.param == "force":
        return forces()
    return gaps()


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
    named = {"noise floor", "no improvement", "cycle"}
    assert len(labels) >= 6
    assert all(label in named or re.search(r"poses?$", label) for label in bare)


def test_a_number_that_is_not_known_is_never_shown(page):
    assert not re.search(r"\b(nan|None|inf)\b", re.sub(r"<style>.*?</style>", "", page, flags=re.S))


def test_the_headline_of_a_comparison_goes_from_setting_to_setting():
    assert headline(comparison()) == "Peak following error: J2 16.7 → 1.67 → 0.167 mrad; J3 16.7 → 1.67 → 0.167 mrad"


def test_terminal_and_page_say_the_same_figures(capsys):
    compared = comparison()
    _show(compared, Session())
    said = capsys.readouterr().out
    page = render_follow(compared)
    for _, settings in figure_rows(compared):
        for _, _, cells in settings:
            assert " ".join(cells) in " ".join(said.split())
            assert all(f">{text}</td>" in page for text in cells)
    assert figure_rows(compared)[0][1][2][2] == ["0.157", "0.167", "0.167", "0.176", "0.228", "0.317"]


def test_a_page_says_where_it_comes_from():
    drives = drives_of([{"node_id": 11, "vendor_id": 0x2A, "serial_number": 7788, "software_version": "2.10\x00"}])
    files = (FileOrigin("out/<run>.h5", "ab" * 32),)
    origin = Origin("2026-03-02 14:05 UTC", "servo-gateway 9.9", drives, files, "A. Person")
    for page in (render_follow(replace(comparison(), origin=origin)), forces(origin=origin)):
        for text in ("2026-03-02 14:05 UTC", "servo-gateway 9.9", "ab" * 32, "out/&lt;run&gt;.h5", "measured by"):
            assert text in page
    page = render_follow(replace(comparison(), origin=origin))
    assert all(text in page for text in (">7788</td>", ">2.10</td>", ">0x2A</td>", "<b>A. Person</b>"))


def test_a_comparison_has_three_drawings_an_axis_on_one_scale():
    page = render_follow(comparison())
    assert page.count('class="three"') == 6
    assert page.count("<svg") == 1 + 18 + 6 + 1 + 1


def test_words_from_the_data_stay_words():
    assert "<script" not in render_follow(comparison(EVIL))
    assert "<script" not in forces(EVIL)


def heights(page, kind):
    """Vertical places of the polylines of a class, of the drawing of the first run."""
    return [
        [float(place.split(",")[1]) for place in points.split()]
        for points in re.findall(rf'<polyline class="{kind}" points="([^"]+)"', page)
    ]


def test_what_is_drawn_against_the_limit_of_the_whole_force_is_the_whole_force():
    """0 to 20 N in the last cycle, to 60 N in the first, the limit at 40 N: all on one scale."""
    page = forces()
    (last,), (first,), (part,) = (heights(page, kind) for kind in ("force", "before-line", "part-line"))
    (limit,) = re.findall(r'<line class="limit" x1="[\d.]+" y1="([\d.]+)"', page)[:1]
    assert (last[0] - float(limit)) / (last[0] - last[1]) == pytest.approx(40 / 20, rel=0.01)
    assert (first[0] - first[1]) / (last[0] - last[1]) == pytest.approx(60 / 20, rel=0.01)
    assert (part[0] - part[1]) / (last[0] - last[1]) == pytest.approx(-12 / 20, rel=0.01)


def test_a_run_of_before_has_its_part_drawn_without_a_limit():
    old = render_pair("p", Limited(FORCE, 40.0, "as estimated"), [run(first_n=(0.0, 60.0), last_n=(0.0, 20.0))])
    along = old[old.index("along the path</h2>") : old.index("<h2>Convergence")]
    assert "part-line" in along
    assert 'class="limit"' not in along


def test_a_pair_whose_last_cycle_is_inside_the_limit_is_good():
    page = forces()
    assert 'class="verdict good"' in page
    assert "C8: largest force 20 N in the last cycle" in page
    for text in ("force [N]", "position along the path [m]", "largest force [N]", "figure 19"):
        assert text in page
