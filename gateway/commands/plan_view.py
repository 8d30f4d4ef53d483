"""Text on the surroundings of an arm, and the pages that draw a plan or a cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gateway.result.library import library_of, read_library
from gateway.result.numerals import with_interval

if TYPE_CHECKING:
    from gateway.acquire.plan import Plan
    from gateway.cell.config import ArmConfig
    from gateway.excite.excitation import MovingPlan
    from gateway.motion.workspace import Workspace


#: Columns of a table of the loads of a library.
LOAD_COLUMNS = ("load", "mass [kg]", "centre [mm]", "frame", "date", "result", "certificate")
#: Number of drawn points per period, and least spacing [s].
CURVE_POINTS, CURVE_STEP_S = 400, 0.01


def space_in_words(workspace: Workspace) -> list[str]:
    """Describe floor, wall, column, links, load and boxes with the source of their size; then what is not checked."""
    space = workspace.space
    lines = [f"{plane.name}: {plane.source}" for plane in space.planes]
    lines += [f"{part.name}: {part.source}" for part in space.body.parts]
    lines += [f"boxes of keep_out: {len(space.boxes_m)}"]
    if space.unchecked:
        lines.append(f"not checked, because they touch at all joint angles: {'; '.join(space.unchecked)}")
    return lines


def loads_in_words(cell: Path) -> list[list[str]]:
    """Return a row of texts, as of `LOAD_COLUMNS`, for each load of the library beside a cell file."""
    path, rows = library_of(cell), []
    for label, load in (read_library(path) if path.exists() else {}).items():
        part, frame = ("com_flange", "flange") if load["com_flange_m"] else ("com", load["frame"])
        pairs: Any = zip(load[f"{part}_m"] or (), load[f"{part}_std_m"] or [None] * 3, strict=False)
        com = "  ".join("?" if None in pair else with_interval(1e3 * pair[0], 1e3 * pair[1]) for pair in pairs)
        mass = with_interval(load["mass_kg"], load["mass_std_kg"] or math.nan)
        rows.append([label, mass, com, frame, *(load[key] or "" for key in ("created", "result", "certificate"))])
    return rows


def view_of_plan(plan: Plan, workspace: Workspace) -> str:
    """Return an HTML page with poses, paths and boxes."""
    from gateway.model.kinematics import flange_frames
    from gateway.motion.joint_path import path_positions, postures_at
    from gateway.report.page import Head
    from gateway.report.scene import PATH, pose_figures, scene_page
    from gateway.result.drawn import DrawnPose

    points = _points(workspace, [pose.q_rad for pose in plan.poses])
    poses = [
        DrawnPose(
            pose=pose.number,
            load="none",
            q_rad=pose.q_rad,
            points_m=tuple((float(x), float(y), float(z)) for x, y, z in points[row]),
        )
        for row, pose in enumerate(plan.poses)
    ]
    path = flange_frames(workspace.robot, postures_at(plan.corners_rad, path_positions(plan.corners_rad)))[:, :3, 3]
    return scene_page(
        Head(f"Plan: {plan.arm}", "Plan of the rest poses", (("arm", plan.arm), ("poses", str(len(poses))))),
        PATH,
        [("", path.tolist())],
        workspace.space.boxes_m.tolist(),
        space_in_words(workspace),
        arm=(f"arm at pose {poses[0].pose}", poses[0].points_m),
        figures=pose_figures(poses, {}),
    )


def view_of_moving_plan(plan: MovingPlan, workspace: Workspace) -> str:
    """Return an HTML page with the paths of trajectories, and position and speed of each joint over one period."""
    from gateway.excite.limits import PLANNED, states_of
    from gateway.model.kinematics import flange_frames
    from gateway.report.page import Head
    from gateway.report.scene import MOTIONS, curve_figures, scene_page

    figures = []
    paths: list[tuple[str, list[list[float]]]] = []
    for excitation in plan.excitations:
        states = states_of(excitation, max(excitation.period_s / CURVE_POINTS, CURVE_STEP_S))
        path = flange_frames(workspace.robot, np.vstack([excitation.start_rad, states.q_rad]))[:, :3, 3]
        paths.append((excitation.name, path.tolist()))
        share = 100.0 * states.qd_rad_s / (PLANNED.speed * workspace.speed_rad_s)
        time_s = np.linspace(0.0, excitation.period_s, len(share) + 1)[1:]
        figures += curve_figures(excitation.name, time_s.tolist(), states.q_rad.T.tolist(), share.T.tolist())
    return scene_page(
        Head(f"Plan: {plan.arm}", "Plan of the trajectories", (("arm", plan.arm), ("motions", str(len(paths))))),
        MOTIONS,
        paths,
        workspace.space.boxes_m.tolist(),
        space_in_words(workspace),
        arm=("arm at its start", _points(workspace, [plan.excitations[0].start_rad.tolist()])[0].tolist()),
        over="Over one period",
        figures=figures,
    )


def view_of_cell(config: ArmConfig, workspace: Workspace, loads: Sequence[Sequence[str]] = ()) -> str:
    """Return an HTML page: the arm at the named postures of the cell and at zero, and its loads (`LOAD_COLUMNS`)."""
    from gateway.report.page import Head
    from gateway.report.scene import ARM, scene_page

    named = {"all joints at 0": (0.0,) * workspace.robot.axes, "home": config.home_rad, "loading": config.loading_rad}
    known = {name: q_rad for name, q_rad in named.items() if q_rad is not None}
    points = _points(workspace, list(known.values())).tolist()
    postures = [(name, [(0.0, 0.0, 0.0), *at]) for name, at in zip(known, points, strict=True)]
    head = Head(f"Cell: {config.name}", "The arm and its surroundings", (("arm", config.name),))
    boxes_m = workspace.space.boxes_m.tolist()
    said, table = space_in_words(workspace), [LOAD_COLUMNS, *loads] if loads else ()
    return scene_page(head, ARM, postures, boxes_m, said, heading="Postures", loads=table)


def _points(workspace: Workspace, postures: Sequence[Sequence[float]]) -> np.ndarray:
    """Return positions of joints and flange (n, N + 1, 3) [m] at postures, base frame."""
    from gateway.model.kinematics import flange_frames, link_frames

    q_rad = np.array(postures)
    return np.concatenate(
        [link_frames(workspace.robot, q_rad)[:, :, :3, 3], flange_frames(workspace.robot, q_rad)[:, None, :3, 3]],
        axis=1,
    )
