"""How thick an arm is: its moving links and its load as capsules, and where each radius comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.model.capsule import Capsule, capsule_of
from gateway.model.mesh import MeshError
from gateway.model.robot import Robot, reach_m

Floats = NDArray[np.float64]

#: Radius of a link that nothing is known of, as a share of the arm's reach: arms of the 10 kg class (reach 1.3 m) have
#: links of 0.10 to 0.15 m in diameter, those of the 165 kg class (2.7 m) of 0.25 to 0.35 m.
ASSUMED_SHARE = 0.05
GEOMETRY = "collision geometry of the URDF"


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Capsules that move with the arm.

    Attributes
    ----------
    part : tuple of k str
        What each capsule belongs to: "link 3", "load".
    link : int array of shape (k,)
        Link, from 0, that it moves with.
    start_m, end_m : arrays of shape (k, 3)
        Ends of its segment in that link's frame.
    radius_m : array of shape (k,)
    source : tuple of str
        Per part, in the order of `parts`: its radius and where that comes from.
    """

    part: tuple[str, ...]
    link: NDArray[np.intp]
    start_m: Floats
    end_m: Floats
    radius_m: Floats
    source: tuple[str, ...]

    @property
    def parts(self) -> tuple[str, ...]:
        """Every part once, in order."""
        return tuple(dict.fromkeys(self.part))

    def segments_m(self, frames: Floats) -> Floats:
        """Ends (n, k, 2, 3) [m] of the segments in the base frame, from link frames (n, N, 4, 4)."""
        of_link = frames[:, self.link]
        ends = np.stack([self.start_m, self.end_m], axis=1)
        return np.matmul(ends, of_link[:, :, :3, :3].transpose(0, 1, 3, 2)) + of_link[:, :, None, :3, 3]

    def levers_m(self, robot: Robot) -> Floats:
        """Farthest (k, N) [m] that a segment's points may lie from each joint axis, in any posture; 0 beyond the link.

        No point of a segment moves farther than these times the joints' turns.
        """
        steps = np.linalg.norm(robot.placement[:, :3, 3], axis=1)
        ends = np.stack([self.start_m, self.end_m], axis=1)
        lever = np.zeros((len(self.link), robot.axes))
        for row, link in enumerate(self.link):
            length = float(np.linalg.norm(ends[row], axis=1).max())
            for joint in range(link):
                lever[row, joint] = steps[joint + 1 : link + 1].sum() + length
            lever[row, link] = np.linalg.norm(np.cross(robot.axis[link], ends[row]), axis=1).max()
        return lever


def body_of(arm: ArmConfig, robot: Robot) -> Body:
    """Body of a configured arm beyond link 1; base and link 1 cannot be moved out of a box and are left out.

    A link is what the URDF's collision geometry says; where that says nothing, or cannot be read, a capsule from the
    link's joint to the next one with the radius of `arm.link_radius_m`, else with an assumed one. Of link 2 such a
    capsule begins a radius away from its joint: the shoulder itself is carried by link 1.
    """
    parts: list[tuple[str, int, Capsule]] = []
    source: list[str] = []
    for link in range(1, robot.axes):
        capsules, words = _link(arm, robot, link)
        parts += [(f"link {link + 1}", link, capsule) for capsule in capsules]
        source.append(words)
    capsules, words = _load(arm, robot)
    parts += [("load", robot.axes - 1, capsule) for capsule in capsules]
    source.append(words)
    return Body(
        part=tuple(part for part, _, _ in parts),
        link=np.array([link for _, link, _ in parts], dtype=np.intp),
        start_m=np.array([capsule.start_m for _, _, capsule in parts]),
        end_m=np.array([capsule.end_m for _, _, capsule in parts]),
        radius_m=np.array([capsule.radius_m for _, _, capsule in parts]),
        source=tuple(source),
    )


def stated_radius_m(arm: ArmConfig, robot: Robot, link: int) -> tuple[float, str]:
    """Radius [m] of a link (from 0) whose shape is not known, and where it comes from."""
    if arm.link_radius_m is None:
        radius = ASSUMED_SHARE * reach_m(robot)
        return radius, f"{radius:.3f} m, assumed: {ASSUMED_SHARE:g} x reach; give arm.link_radius_m"
    radius = arm.link_radius_m[link] if isinstance(arm.link_radius_m, tuple) else arm.link_radius_m
    return radius, f"{radius:g} m, arm.link_radius_m"


def _link(arm: ArmConfig, robot: Robot, link: int) -> tuple[list[Capsule], str]:
    capsules: list[Capsule] = []
    unusable: list[str] = []
    for body in robot.shapes[link]:
        try:
            capsules.append(capsule_of(body, robot.source))
        except MeshError as error:
            unusable.append(str(error))
    if any(body.own for body in robot.shapes[link]) and not unusable:
        return capsules, GEOMETRY
    radius, words = stated_radius_m(arm, robot, link)
    capsules.append(_bone(robot, link, radius))
    return capsules, f"{words} ({'; '.join(unusable)})" if unusable else words


def _bone(robot: Robot, link: int, radius_m: float) -> Capsule:
    """Capsule from a link's joint to the next one, of the last link to the flange."""
    start = np.zeros(3)
    end = robot.placement[link + 1, :3, 3] if link + 1 < robot.axes else _flange_m(robot)
    length = float(np.linalg.norm(end))
    if link == 1 and length > 0.0:
        start = min(radius_m / length, 1.0) * end
    return Capsule(start, end, radius_m)


def _flange_m(robot: Robot) -> Floats:
    return np.zeros(3) if robot.flange is None else robot.flange[:3, 3]


def _load(arm: ArmConfig, robot: Robot) -> tuple[list[Capsule], str]:
    """From the flange to every point of the load; without such points the flange alone."""
    flange = _flange_m(robot)
    if arm.load_radius_m is not None:
        radius, words = arm.load_radius_m, f"{arm.load_radius_m:g} m, arm.load_radius_m"
    elif arm.load_points_m:
        radius, words = stated_radius_m(arm, robot, robot.axes - 1)
        words = f"as link {robot.axes}: {words}; give arm.load_radius_m"
    else:
        radius, words = 0.0, "not stated, only the flange is kept out; give arm.load_points_m"
    return list(_star(flange, arm.load_points_m, radius)), words


def _star(flange: Floats, points: tuple[tuple[float, float, float], ...], radius_m: float) -> Iterator[Capsule]:
    if not points:
        yield Capsule(flange, flange, radius_m)
    for point in points:
        yield Capsule(flange, np.array(point), radius_m)
