"""The page on a stop: the last seconds of every axis and what the bus said, the stop at t = 0."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gateway.data.blackbox.part import BoxHeader, pack, width_of
from gateway.data.blackbox.ring_buffer import BOTH_KILLED, Ring, folder_of
from gateway.report.stop import PIECES, courses, curves_of, render_stop
from tests.support.pages.stop import AXES, CELL, PERIOD_S, REASON, SYNCS, stopped
from tests.support.rigs.command_line import run


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return stopped(tmp_path_factory.mktemp("stopped"))


def test_every_axis_has_torque_error_and_speed_with_units(box):
    page = render_stop(box)
    for axis in range(1, AXES + 1):
        for label in ("torque [Nm]", "error [mrad]", "speed [rad/s]"):
            assert f">J{axis} {label}</text>" in page
    assert page.count(">time from the stop [s]</text>") == 3 * AXES + 1
    assert page.count('class="limit"') == 3 * AXES + 1
    assert REASON in page
    assert "run.blackbox.blf" in page
    assert not re.search(r"(src|href)=", page)


def test_the_error_is_against_what_was_due_at_the_sync_and_the_speed_is_of_the_joint(box):
    curves = curves_of(box.arms[0], PERIOD_S * np.arange(1 - SYNCS, 1.0), box.sync_index)
    assert curves.time_s[-1] == 0.0
    assert curves.error_rad[1:, 0] == pytest.approx(0.002)
    assert curves.speed_rad_s[2:, 0] == pytest.approx(0.5)
    assert np.isnan(curves.error_rad[0]).all()
    assert np.isnan(curves.speed_rad_s[200:210, 1]).all()


def test_after_a_sync_without_sample_the_error_is_not_shown(box):
    kept = np.delete(np.arange(SYNCS), 300)
    arm = replace(box.arms[0], values={name: values[kept] for name, values in box.arms[0].values.items()})
    curves = curves_of(arm, box.time_s[kept] - box.time_s[-1], box.sync_index[kept])
    assert np.isnan(curves.error_rad[300]).all()
    assert curves.error_rad[301, 0] == pytest.approx(0.002)


def test_the_table_holds_how_the_axes_stood(box):
    page = render_stop(box)
    cells = dict(re.findall(r"<tr><td>([^<]+)</td><td class=\"n\" data-th=\"J1\">([^<]+)</td>", page))
    assert float(cells["position [deg]"]) == pytest.approx(np.degrees(0.5 * 3.99), abs=0.005)
    assert float(cells["following error [mrad]"]) == pytest.approx(2.0)
    assert (float(cells["torque [Nm]"]), float(cells["model [Nm]"])) == (3.0, 1.0)


def test_a_line_has_gaps_and_keeps_every_peak():
    many = 50_000
    time_s, sync_index = np.linspace(-10.0, 0.0, many), np.arange(many)
    values = np.zeros(many)
    values[31_234], values[44_000] = 7.0, -5.0
    sync_index[20_000:] += 3
    first, second = courses(time_s, sync_index, values)
    assert first[-1][0] < second[0][0]
    assert (max(y for _, y in second), min(y for _, y in second)) == (7.0, -5.0)
    assert second[-1] == (0.0, 0.0)
    assert len(first) + len(second) <= 4 * (PIECES + 1)
    assert courses(time_s[:3], sync_index[:3], np.full(3, np.nan)) == []


def test_a_stop_before_the_first_sample_has_a_page_too(box):
    held = {name: values[:0] for name, values in box.arms[0].values.items()}
    early = replace(
        box,
        arms=(replace(box.arms[0], values=held),),
        wall_s=box.wall_s[:0],
        time_s=box.time_s[:0],
        sync_index=box.sync_index[:0],
    )
    assert "No sample: the arm was stopped before it was led." in render_stop(early)
    nothing = replace(early, frames=box.frames[:0])
    assert "no answer of a drive that the cell names is in the box" in render_stop(nothing)


def test_report_draws_the_box_beside_a_recording_and_the_box_itself(tmp_path):
    box = stopped(tmp_path)
    page = tmp_path / "stop.html"
    summary = json.loads(run("report", tmp_path / "run.h5", "-o", page, "--json", "-").stdout)
    assert summary == {"schema": 1, "report": str(page), "recording": "run.h5", "reason": REASON}
    beside = page.read_text(encoding="utf-8")
    assert run("report", box.path, "-o", page).exit_code == 0
    assert page.read_text(encoding="utf-8") == beside


def test_what_both_killed_have_left_is_drawn(tmp_path):
    run_file = tmp_path / "run.h5"
    ring = Ring(BoxHeader(run_file, (("main", AXES),), CELL, "now", "test"))
    ring.add(1, pack(np.zeros((2, width_of(AXES))), b"", 1.0, 2.0))
    ring.close()
    assert run("report", run_file, "-o", tmp_path / "stop.html").exit_code == 0
    assert BOTH_KILLED in (tmp_path / "stop.html").read_text(encoding="utf-8")
    assert not folder_of(run_file).exists()


def test_a_recording_without_a_black_box_is_said(tmp_path):
    (tmp_path / "run.h5").write_bytes(b"")
    done = run("report", tmp_path / "run.h5", "-o", tmp_path / "stop.html")
    assert done.exit_code == 3
    assert "no black box (run.blackbox.h5) beside it" in done.stderr
