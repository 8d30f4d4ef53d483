"""Paths from files: what they become, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.cell.config import load_cell
from gateway.errors import InputError, PlanRefused
from gateway.follow.path import check_path, read_path
from gateway.model.arm_model import arm_robot
from gateway.model.kinematics import flange_frames
from gateway.motion.workspace import workspace_of
from tests.data.around import NO_BOX, among_boxes

EXAMPLES = Path(__file__).parents[3] / "examples"
PERIOD_S = 0.01


@pytest.fixture(params=["large", "small"])
def example(request):
    loaded = load_cell(EXAMPLES / request.param / "cell.toml")
    return request.param, workspace_of(loaded.cell.arm[0], arm_robot(loaded, loaded.cell.arm[0]))


@pytest.fixture
def workspace():
    loaded = load_cell(EXAMPLES / "large" / "cell.toml")
    return workspace_of(loaded.cell.arm[0], arm_robot(loaded, loaded.cell.arm[0]))


def write(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_the_example_paths_stay_inside_every_limit(example):
    name, workspace = example
    file = EXAMPLES / name / ("path.toml" if name == "large" else "path.csv")
    path = read_path(file, workspace, PERIOD_S)
    check_path(path, workspace)
    at = path.start_rad
    for motion in path.motions:
        points = np.vstack([at, motion.q_rad])
        rate = np.diff(points, axis=0) / PERIOD_S
        gain = np.diff(np.vstack([np.zeros(6), rate, np.zeros(6)]), axis=0) / PERIOD_S
        assert (np.abs(rate) <= workspace.speed_rad_s * 1.001).all()
        assert (np.abs(gain) <= workspace.acceleration_rad_s2 * 1.02).all()
        assert (motion.qd_rad_s[-1] == 0).all()
        at = motion.q_rad[-1]


def test_waypoints_are_reached_at_rest_and_repeated(tmp_path, workspace):
    text = "waypoints_rad = [[0,0,0,0,0,0], [0.1,0,0,0,0,0], [0.1,0.1,0,0,0,0]]\nrepeat = 2\nspeed_share = 0.5\n"
    path = read_path(write(tmp_path, "p.toml", text), workspace, PERIOD_S)
    ends = [motion.q_rad[-1, :2].tolist() for motion in path.motions]
    assert ends == [[0.1, 0.0], [0.1, 0.1], [0.0, 0.0], [0.1, 0.0], [0.1, 0.1]]
    assert max(np.abs(m.qd_rad_s).max() for m in path.motions) <= 0.5 * workspace.speed_rad_s[0] + 1e-9
    assert path.name == "p"
    assert path.duration_s == pytest.approx(sum(m.duration_s for m in path.motions) + 5 * 0.4)


@pytest.mark.parametrize("share", [1.0, 0.1, 0.01])
@pytest.mark.parametrize("length_rad", [0.001, 0.05, 1.0])
def test_no_path_that_is_short_enough_is_called_too_long(tmp_path, workspace, monkeypatch, length_rad, share):
    text = (
        f"waypoints_rad = [[0,0,0,0,0,0], [{length_rad},0,0,{-length_rad},0,0]]\nspeed_share = {share}\ndwell_s = 0\n"
    )
    file = write(tmp_path, "p.toml", text)
    taken_s = read_path(file, workspace, PERIOD_S).duration_s
    monkeypatch.setattr("gateway.follow.path.LONGEST_S", taken_s + 1e-6)
    assert read_path(file, workspace, PERIOD_S).duration_s == taken_s


def test_a_csv_without_times_holds_waypoints(tmp_path, workspace):
    text = "# a comment\nq1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n0,0,0,0,0,0\n0.1,0,0,0,0,0\n"
    assert len(read_path(write(tmp_path, "p.csv", text), workspace, PERIOD_S).motions) == 1


def test_a_timed_path_passes_its_points_in_time(tmp_path, workspace):
    rows = [(t, 0.1 * t**3 * (10 - 15 * t / 4 + 6 * t**2 / 16) / 64) for t in (0, 1, 2, 3, 4)]
    text = "time_s,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n" + "".join(f"{t},{q},0,0,0,0,0\n" for t, q in rows)
    path = read_path(write(tmp_path, "p.csv", text), workspace, PERIOD_S)
    (motion,) = path.motions
    for t, q in rows[1:]:
        assert motion.q_rad[round(t / PERIOD_S) - 1, 0] == pytest.approx(q, abs=1e-9)
    # the points are those of a polynomial of fifth order at rest at both ends, which the spline is then
    at = np.arange(1, 401) * PERIOD_S
    np.testing.assert_allclose(motion.q_rad[:, 0], 0.1 * at**3 * (10 - 15 * at / 4 + 6 * at**2 / 16) / 64, atol=1e-9)


TIMED = "time_s,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n"


@pytest.mark.parametrize(
    ("name", "text", "error", "words"),
    [
        ("p.toml", "waypoints_rad = [[0,0,0,0,0,0]]", InputError, "waypoints_rad"),
        ("p.toml", "waypoints_rad = [[0,0,0,0,0], [0,0,0,0,0.1]]", InputError, "waypoints_rad"),
        ("p.toml", "waypoints_rad = [[0,0,0,0,0,0], [0,0,0,0,0,nan]]", InputError, "waypoints_rad"),
        ("p.toml", "waypoints_rad = [[0,0,0,0,0,0], [0,0,0,0,0,0]]", InputError, "same posture"),
        ("p.toml", "waypoints_rad = [[0,0,0,0,0,0], [0,0,0,0,0,1]]\nspeed = 2", InputError, "speed"),
        ("p.toml", "waypoints_rad = [[0,0", InputError, "not valid TOML"),
        ("p.csv", "q1_rad,q2_rad\n0,0\n", InputError, "column q3_rad is missing"),
        ("p.csv", "", InputError, "is empty"),
        ("p.csv", TIMED + "0,0,0,0,0,0,zero\n", InputError, "p.csv:2: q6_rad: 'zero' is not a finite number"),
        ("p.csv", TIMED + "0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n1,0,0,0,0,0,0\n2,0,0,0,0,0,0\n", InputError, "increase"),
        ("p.csv", TIMED + "0,0,0,0,0,0,0\n1e-300,1,0,0,0,0,0\n1,0,0,0,0,0,0\n2,0,0,0,0,0,0\n", InputError, "0.1 ms"),
        ("p.csv", TIMED + "".join(f"{t},{t},0,0,0,0,0\n" for t in range(5)), PlanRefused, "joint 1 reaches"),
        ("p.csv", TIMED[7:] + "0,0,0,0,0,0\n" * 1001, InputError, "1001 waypoints"),
        ("p.toml", f"waypoints_rad = [{'[1,0,0,0,0,0], [-1,0,0,0,0,0],' * 200}]", InputError, "the limit is 600 s"),
        ("p.toml", "waypoints_rad = [[0,0,0,0,0,0], [9000,0,0,0,0,0]]", InputError, "at least, the limit is 600 s"),
        ("p.toml", "speed_share = 1e-9\nwaypoints_rad = [[0,0,0,0,0,0], [1,0,0,0,0,0]]", InputError, "at least"),
        ("p.toml", "waypoints_rad = [[0,0,0,0,0,0], [1e300,0,0,0,0,0]]", InputError, "beyond 10000 rad"),
        ("p.csv", TIMED[7:] + "0,0,0,0,0,0\n0,-1e308,0,0,0,0\n", InputError, "beyond 10000 rad"),
        ("none.toml", None, InputError, "cannot be read"),
    ],
)
def test_what_is_no_path_is_refused(tmp_path, workspace, name, text, error, words):
    file = tmp_path / name if text is None else write(tmp_path, name, text)
    with pytest.raises(error, match=words):
        read_path(file, workspace, PERIOD_S)


def test_a_path_out_of_the_workspace_is_refused_with_its_place(tmp_path, workspace):
    text = "waypoints_rad = [[0,0,0,0,0,0], [3.0,0,0,0,0,0]]"
    with pytest.raises(PlanRefused, match=r"at \d+\.\d+ s.*joint 1 outside"):
        check_path(read_path(write(tmp_path, "p.toml", text), workspace, PERIOD_S), workspace)
    text = "waypoints_rad = [[3.0,0,0,0,0,0], [0,0,0,0,0,0]]"
    with pytest.raises(PlanRefused, match="joint 1 outside"):
        check_path(read_path(write(tmp_path, "p.toml", text), workspace, PERIOD_S), workspace)


def test_a_box_between_two_set_points_is_met(tmp_path, workspace):
    """Thin links, a box of 20 mm: no setpoint of this coarse path is in it, the segment between is."""
    text = TIMED + "".join(f"{2 * t},{-0.3 + 0.2 * t},1,0,0,0,0\n" for t in range(4))
    path = read_path(write(tmp_path, "p.csv", text), replace(workspace, jerk_rad_s3=workspace.jerk_rad_s3 * 50), 0.5)
    q_rad = path.motions[0].q_rad
    row = int(np.argmax(np.diff(q_rad[:, 0])))
    centre = flange_frames(workspace.robot, q_rad[row : row + 2].mean(axis=0)[None])[0, :3, 3]
    boxed = among_boxes(workspace, np.array([[centre - 0.01, centre + 0.01]]), radius_m=0.0)
    assert boxed.feasible(q_rad).all()
    check_path(path, among_boxes(workspace, NO_BOX))
    with pytest.raises(PlanRefused, match=r"at \d\.\d\d s, .*keep_out box 1"):
        check_path(path, boxed)
