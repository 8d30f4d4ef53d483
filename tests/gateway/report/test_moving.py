"""Results of motion, on the page and at the terminal: inertia, friction over speed, rotors, one period."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gateway.commands.console import Session
from gateway.commands.result_output import show_result
from gateway.report.moving_section import (
    axis_rows,
    friction_views,
    inertia_view,
    period_figures,
    period_of,
    sliding_figure,
)
from gateway.report.render import render
from gateway.report.view import view
from gateway.result.result import AxisMotion, Result, from_json
from tests.support.pages.moving import COULOMB, VISCOUS, moving_result

NAN = float("nan")


@pytest.fixture(scope="module")
def moving():
    return moving_result()


def test_the_inertia_is_in_a_table_with_its_principal_values(moving):
    shown = inertia_view(moving.loads[0])
    assert shown.frame == "link_6"
    assert shown.parts[0] == ("Ixx", "2.04", "0.12")
    assert shown.parts[4] == ("Ixz", "\N{MINUS SIGN}0.290", "0.059")
    tensor = np.array([[2.04, 0.38, -0.29], [0.38, 3.01, 0.21], [-0.29, 0.21, 1.47]])
    largest, middle, least = np.linalg.eigvalsh(tensor)[::-1]
    assert [float(text.split(" ")[0]) for text in shown.principal] == pytest.approx([largest, middle, least], abs=6e-3)


def test_principal_values_have_the_spread_of_drawn_tensors(moving):
    load = replace(moving.loads[0], inertia_kg_m2=(2.0, 4.0, 1.2, 0.5, -0.3, 0.2), inertia_std_kg_m2=(0.02,) * 6)
    random = np.random.default_rng(3)
    drawn = np.array(load.inertia_kg_m2) + 0.02 * random.normal(size=(20_000, 6))
    xx, yy, zz, xy, xz, yz = drawn.T
    tensors = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    spread = 1.96 * np.linalg.eigvalsh(tensors)[:, ::-1].std(axis=0)
    deviations = [float(text.split("± ")[1]) for text in inertia_view(load).principal]
    assert deviations == pytest.approx(spread, rel=0.03)


def test_a_moment_that_is_not_known_is_said_and_leaves_no_principal_values(moving):
    load = replace(moving.loads[0], inertia_kg_m2=(2.0, 3.0, NAN, 0.0, 0.0, 0.0))
    shown = inertia_view(load)
    assert shown.parts[2] == ("Izz", "unknown", "")
    assert shown.principal == ()
    assert inertia_view(replace(load, inertia_kg_m2=(NAN,) * 6)) is None
    assert inertia_view(replace(load, inertia_kg_m2=None)) is None


def test_the_curve_is_the_friction_of_the_axis_and_its_band_the_interval(moving):
    views = friction_views(moving)
    assert [one.joint for one in views] == [1, 2, 3, 4, 5, 6]
    speed, torque, half = (np.array(values) for values in (views[1].speed_rad_s, views[1].torque_nm, views[1].half_nm))
    np.testing.assert_allclose(torque, 95.0 + 90.0 * speed)
    np.testing.assert_allclose(half, 1.96 * np.hypot(0.02 * 95.0, 0.04 * 90.0 * speed))
    fourth = views[3]
    slow = np.exp(-((np.array(fourth.speed_rad_s) / 0.06) ** 2))
    np.testing.assert_allclose(fourth.torque_nm, 17.0 + 7.0 * slow + 21.0 * np.array(fourth.speed_rad_s))
    assert fourth.torque_nm[0] == 24.0


def test_the_measured_rows_lie_about_the_curve_in_both_senses(moving):
    for one in friction_views(moving):
        speed, friction = np.array(one.points).T
        assert len(speed) > 100
        true = np.sign(speed) * COULOMB[one.joint - 1] + VISCOUS[one.joint - 1] * speed
        assert abs(np.mean(friction - true)) < 0.08 * COULOMB[one.joint - 1]
        assert (speed > 0).any()
        assert (speed < 0).any()


def test_axes_of_which_friction_or_its_spread_is_not_known(moving):
    first, second, *_ = moving.motion
    deviations = replace(moving, motion=(replace(first, coulomb_nm=NAN), replace(second, coulomb_std_nm=NAN)))
    (only,) = friction_views(deviations)
    assert (only.joint, only.half_nm) == (2, ())
    assert "confidence" not in sliding_figure(only)[1]
    assert friction_views(replace(deviations, rows=None, motion=(replace(second, speed_rad_s=NAN),))) == []


def test_the_table_of_the_axes_has_dashes_where_nothing_is_estimated():
    rows = dict(axis_rows((AxisMotion(2, rotor_inertia_kg_m2=305.0, rotor_inertia_std_kg_m2=6.0),), 3))
    assert rows == {"rotor inertia [kg m2]": ["\N{EN DASH}", "305 ± 12", "\N{EN DASH}"]}
    assert axis_rows((), 6) == []


def test_the_period_is_one_in_which_all_joints_move_with_a_load(moving):
    period = period_of(moving)
    assert (period.run, period.load) == ("run.h5 period 2", "tool")
    assert period.time_s[0] == 0.0
    assert (np.diff(period.time_s) > 0).all()
    panels = period_figures(period)
    assert [len(row) for row in panels] == [3] * 6
    text = "".join(drawing for row in panels for _, drawing in row)
    for label in ("J3 position [deg]", "J3 torque [Nm]", "J3 residual [Nm]", "time in the period [s]"):
        assert label in text


def test_a_period_that_was_tried_slowly_is_not_drawn_and_lines_break_at_a_standstill(moving):
    """A load is tried at a quarter of the speed: more rows, and none that was measured for the load."""
    rows, slow = moving.rows, moving.rows.run[-1]
    time_s = tuple(4.0 * at if run == slow else at for at, run in zip(rows.time_s, rows.run, strict=True))
    tau = [list(row) for row in rows.tau_nm]
    drawn = period_of(replace(moving, rows=replace(rows, time_s=time_s)))
    assert drawn.run != slow
    later_s = tuple(at + 1e3 * (run == slow) for at, run in zip(time_s, rows.run, strict=True))
    merged = replace(rows, time_s=later_s, run=tuple(drawn.run if run == slow else run for run in rows.run))
    assert len(period_of(replace(moving, rows=merged)).time_s) == len(drawn.time_s)
    mine = [row for row, run in enumerate(rows.run) if run == drawn.run]
    for row in mine[len(mine) // 3 : len(mine) // 2]:
        tau[row][0] = NAN
    broken = period_of(replace(moving, rows=replace(rows, time_s=time_s, tau_nm=tuple(map(tuple, tau)))))
    (_, _, (_, residual)), *_ = period_figures(broken)
    assert residual.count("<polyline") == 2


def test_rest_poses_are_no_period(full_result):
    rest = from_json(json.dumps(full_result))
    assert period_of(rest) is None
    assert period_of(Result(robot="r")) is None
    assert view(rest)["motion"] == ()
    page = render(rest)
    assert "One period" not in page
    assert "Friction over speed" not in page


def test_the_page_shows_inertia_friction_and_the_period(moving):
    page = render(moving)
    assert "Inertia about the centre of gravity, axes of link_6" in page
    assert "principal values 3.15" in page
    assert len(re.findall(r'aria-label="Friction of J\d over its speed"', page)) == 6
    assert len(re.findall(r'aria-label="Torque of J\d over one period', page)) == 6
    assert "305 ± 12" in page
    assert "None" not in page


def test_the_terminal_shows_the_same_numbers(moving):
    shown = []

    class Kept(Session):
        def show(self, item):
            shown.append(item)

    show_result(moving, Kept(0))
    titles = {str(table.title): table for table in shown if hasattr(table, "title")}
    inertia = next(table for title, table in titles.items() if title.startswith("inertia about"))
    assert [list(column.cells) for column in inertia.columns][1] == ["2.04 ± 0.12"]
    axes = next(table for title, table in titles.items() if title.startswith("identified from motion"))
    rows = list(zip(*(column.cells for column in axes.columns), strict=True))
    assert (
        "rotor inertia [kg m2]",
        "220.0 ± 8.6",
        "305 ± 12",
        "175.0 ± 6.9",
        "31.0 ± 1.2",
        "22.00 ± 0.86",
        "–",
    ) in rows
