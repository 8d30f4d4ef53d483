"""No figure of a page contradicts another."""

import json
import re

from gateway.report.evidence import friction_figure
from gateway.report.load_figures import load_change_figure
from gateway.report.render import render
from gateway.result.result import from_json


def test_the_friction_that_is_drawn_is_the_one_in_the_table(full_result):
    found = from_json(json.dumps(full_result))
    drawn = re.findall(r">([\d.]+) Nm</text>", friction_figure(found))
    # the bands that the sample states
    assert drawn == ["9", "40", "22", "4", "3.1", "2.2"]
    (row,) = re.findall(r"<tr><td>friction band</td>(.*?)</tr>", render(found))
    assert re.findall(r">([\d.]+)</td>", row) == drawn


def test_the_change_of_a_load_is_shown_in_the_frame_of_its_card(full_result):
    found = from_json(json.dumps(full_result))
    labels = re.findall(r">([^<>]+ \u2192 [^<>]+)</text>", load_change_figure(found))
    # z of the first load: 166 before, 180 after in the flange, 100 more in link 6
    assert labels[3] == "166.0 \u2192 180.0 mm"
    assert "<b>180.0</b>" in render(found)
