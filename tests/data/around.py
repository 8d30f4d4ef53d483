"""Workspaces with other boxes around the same arm: nothing else is then kept apart from it."""

from dataclasses import replace

import numpy as np

from gateway.model.solid import Capsule, solid_capsule
from gateway.motion.body import Body, body_of_parts
from gateway.motion.clearance import BOX, space_between
from gateway.motion.workspace import Workspace

NO_BOX = np.empty((0, 2, 3))


def as_thick_as(body: Body, radius_m: float) -> Body:
    """The same capsules with another radius."""
    return body_of_parts(
        [
            replace(
                part,
                solids=tuple(
                    solid_capsule(Capsule(solid.around.start_m, solid.around.end_m, radius_m)) for solid in part.solids
                ),
            )
            for part in body.parts
        ]
    )


def among_boxes(workspace: Workspace, boxes_m: np.ndarray, radius_m: float | None = None) -> Workspace:
    """Links beyond the first and load among these boxes alone, their capsules with another radius if one is given."""
    body = workspace.space.body if radius_m is None else as_thick_as(workspace.space.body, radius_m)
    limits = (workspace.lower_rad, workspace.upper_rad)
    space = space_between(workspace.robot, body, boxes_m, (), limits)
    rows = (space.pairs.kind == BOX) & (body.link[space.pairs.first] > 0)
    return replace(workspace, space=replace(space, pairs=space.pairs.only(rows), narrow=space.narrow[rows]))
