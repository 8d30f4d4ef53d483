"""The page on an acceptance over the workspace: decision, map, residual by pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from markupsafe import Markup

from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits
from gateway.result.numerals import significant
from gateway.result.origin import Origin

HEADLINES: Final = {
    "pass": ("good", "Pass: the torque error is within the tolerance over the whole workspace"),
    "fail": ("bad", "Fail: the torque error exceeds the tolerance somewhere in the workspace"),
    "cannot tell": ("open", "Cannot tell: the data do not decide"),
}
_WIDTH: Final = 620.0
_HEIGHT: Final = 460.0


def render_acceptance(answer: Mapping[str, Any], origin: Origin) -> str:
    """HTML text of the page; `answer` is what `accept --json` writes."""
    status, headline = HEADLINES[answer["outcome"]]
    about = (("robot", answer["robot"]), ("arm", answer["arm"]), ("", origin.created), ("", origin.software))
    return page(
        "acceptance.html.j2",
        Head(f"Acceptance: load {answer['load']}", "Acceptance over the workspace", about),
        status=status,
        headline=headline,
        answer=answer,
        map=acceptance_map(answer),
        axes=[f"J{joint}" for joint in range(1, len(answer["tolerance_nm"]) + 1)],
        rows=[("tolerance", [significant(value) for value in answer["tolerance_nm"]])]
        + [
            (f"pose {pose['pose']}, residual", [significant(value) for value in pose["residual_nm"]])
            for pose in answer["poses"]
        ],
        flange=[
            (str(pose["pose"]), significant(pose["flange_force_n"]), significant(pose["flange_moment_nm"]))
            for pose in answer["poses"]
        ],
    )


def acceptance_map(answer: Mapping[str, Any]) -> Markup:
    """Side view of the workspace: a dot per posture at the place of the flange, coloured by the error there."""
    dots = sorted(answer["map"], key=lambda dot: dot["error"])
    poses = answer["poses"]
    reach = [math.hypot(*dot["flange_m"][:2]) for dot in (*dots, *poses)]
    height = [dot["flange_m"][2] for dot in (*dots, *poses)]
    panel = Panel(_WIDTH, _HEIGHT, limits(reach), limits(height), left=64.0, bottom=40.0)
    panel.x_axis("distance of the flange from axis 1 [m]")
    panel.y_axis("height of the flange [m]")
    for dot in dots:
        low, high = dot["error"] - dot["guard"], dot["error"] + dot["guard"]
        kind = "within" if high <= 1.0 else "beyond" if low > 1.0 else "between"
        title = f"error {significant(dot['error'], 2)} of the tolerance, guard band {significant(dot['guard'], 2)}"
        panel.dot(math.hypot(*dot["flange_m"][:2]), dot["flange_m"][2], f"map-{kind}", title, 3.0)
    for pose in poses:
        place = (math.hypot(*pose["flange_m"][:2]), pose["flange_m"][2])
        panel.dot(*place, "map-measured", f"pose {pose['pose']}", 5.5)
    return panel.svg(f"Map of the workspace: {answer['outcome']}")
