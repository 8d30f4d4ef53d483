"""Parse URDF text to the chain of its driven joints, as written: structure and refusals only, no arithmetic.

A driven joint is revolute or continuous and mimics no other joint. The arm is the path from the root to the last link,
its tip. Every other movable joint (linear track, finger, balancer, branch) is fixed at zero, and listed.
"""

from __future__ import annotations

import difflib
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from gateway.errors import ConfigError
from gateway.model.urdf_shapes import Pose, Shape, Three, Unknown, number, origin, shapes_of, three
from gateway.model.urdf_text import parse_urdf

TURNING = ("revolute", "continuous")
#: Joint types that are not fixed and not driven: fixed at zero outside the arm.
PASSIVE: Final = ("prismatic", "floating", "planar")
#: Largest number of joints: more than twice that of a humanoid with two hands.
MOST_JOINTS: Final = 500
#: Names of the mounting plane of a tool, in order of preference: joints beyond it are not axes of the arm.
FLANGES: Final = ("tool0", "flange")
#: Names of a link at the end of an arm, in addition to those of a flange.
_HANDS: Final = frozenset({*FLANGES, "tool", "hand", "tcp", "ee", "eef", "effector"})
#: Largest number of joints in series in a gripper jaw.
_JOINTS_OF_A_JAW: Final = 2
#: Parts of names of joints or links of a gripper.
_GRIPPER: Final = re.compile(r"finger|gripper|jaw|knuckle|claw|thumb", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Inertial:
    """Element `<inertial>`: tensor (xx, xy, xz, yy, yz, zz) [kg m2] about the centre of mass, in `pose`."""

    pose: Pose
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Joint:
    """Revolute joint; `fixed_before` are the fixed joints between the previous moved link and this joint."""

    name: str
    child: str
    xyz_m: Three
    rpy_rad: Three
    axis: Three
    lower_rad: float
    upper_rad: float
    velocity_rad_s: float
    effort_nm: float
    fixed_before: tuple[Pose, ...]


@dataclass(frozen=True, slots=True)
class PlacedShape:
    """Shape of `<collision>` and the poses that lead to it from the moved link."""

    poses: tuple[Pose, ...]
    shape: Shape


@dataclass(frozen=True, slots=True)
class MovedLink:
    """Link moved by a joint: its own inertial and shapes, and those of links fixed to it with the poses between."""

    name: str
    own: Inertial | None
    fixed: tuple[tuple[tuple[Pose, ...], Inertial], ...]
    own_shapes: tuple[PlacedShape, ...]
    fixed_shapes: tuple[PlacedShape, ...]


@dataclass(frozen=True, slots=True)
class FixedFrame:
    """Link fixed to the last link of the arm, and the poses that lead to it from there."""

    name: str
    poses: tuple[Pose, ...]


@dataclass(frozen=True, slots=True)
class Chain:
    """Driven joints from the root to the tip, the link each of them moves, and the shapes of the fixed base.

    Attributes
    ----------
    name : str
    joints : tuple of Joint
    links : tuple of MovedLink
    base_shapes : tuple of PlacedShape
    fixed_at_zero : tuple of str
        Movable joints that are fixed at zero, each with its kind.
    unused_shapes : tuple of str
        Shapes of `<collision>` that cannot be used, with the reason.
    frames : tuple of FixedFrame
        Links connected to the last link by fixed joints only, in the order of the file.
    """

    name: str
    joints: tuple[Joint, ...]
    links: tuple[MovedLink, ...]
    base_shapes: tuple[PlacedShape, ...]
    fixed_at_zero: tuple[str, ...]
    unused_shapes: tuple[str, ...]
    frames: tuple[FixedFrame, ...]


def read_chain(text: str, where: str, tip: str | None = None) -> Chain:
    """Return the chain of driven joints of a URDF.

    Parameters
    ----------
    text : str
    where : str
        Name of the file, for messages.
    tip : str, optional
        Last link of the arm. Without it there must be only one path of driven joints, without a gripper.

    Raises
    ------
    ConfigError
        The URDF is not usable, or the joints of the arm are ambiguous; the message names file, element and option.
    """
    tree = _Tree(parse_urdf(text, where), where)
    return tree.chain(tree.path_to(tip) if tip is not None else tree.only_path())


def name_the_tip(link: str) -> str:
    """Return the instruction how to name the last link of the arm."""
    return f'name the last link of the arm: --tip {link}, in a cell file tip = "{link}"'


class _Tree:
    """Links and joints of a URDF by name."""

    def __init__(self, root: ET.Element, where: str) -> None:
        self.name, self.where = root.get("name", "robot"), where
        self.links = _named(root, "link", where)
        self.parent: dict[str, ET.Element] = {}
        self.children: dict[str, list[ET.Element]] = {name: [] for name in self.links}
        joints = _named(root, "joint", where)
        if len(joints) > MOST_JOINTS:
            raise ConfigError(f"{where}: {len(joints)} joints, the limit is {MOST_JOINTS}; name the URDF of one arm")
        for name, joint in joints.items():
            if joint.get("type") not in (*TURNING, *PASSIVE, "fixed"):
                known = ", ".join((*TURNING, *PASSIVE, "fixed"))
                raise ConfigError(
                    f"{where}: joint '{name}' is of type '{joint.get('type')}', which must be one of {known}; correct"
                    " it"
                )
            above, child = (_reference(joint, tag, name, self.links, where) for tag in ("parent", "child"))
            if child in self.parent:
                raise ConfigError(
                    f"{where}: link '{child}' is the child of two joints, '{self.parent[child].get('name')}' and"
                    f" '{name}'; the arm must be an open chain: remove the joint that closes the loop"
                )
            self.parent[child] = joint
            self.children[above].append(joint)
        roots = [name for name in self.links if name not in self.parent]
        if len(roots) != 1:
            found = ", ".join(roots) or "a closed loop"
            raise ConfigError(
                f"{where}: expected one root link, found {len(roots)}: {found}; join the others to it by joints of"
                ' type="fixed", or remove them'
            )
        self.root = roots[0]
        self.reached = [self.root]
        for link in self.reached:
            self.reached += map(_child, self.children[link])

    def path_to(self, tip: str) -> list[ET.Element]:
        """Return the joints from the root to a link."""
        if tip not in self.links:
            near = difflib.get_close_matches(tip, self.links, 3, 0.5) or list(self.links)[-8:]
            raise ConfigError(f"{self.where}: there is no link '{tip}' for the tip; links are {', '.join(near)}")
        if tip not in self.reached:
            raise ConfigError(f"{self.where}: the joints above link '{tip}' form a closed loop; remove one of them")
        path: list[ET.Element] = []
        while tip in self.parent:
            path.append(self.parent[tip])
            tip = _parent(path[-1])
        return path[::-1]

    def likely_tip(self) -> str:
        """Return the probable last link of the arm: before a gripper or two equal short branches."""
        below = dict.fromkeys(self.reached, 0)
        for link in reversed(self.reached[1:]):
            above = _parent(self.parent[link])
            below[above] = max(below[above], below[link] + _is_driven(self.parent[link]))
        current, last, axes = self.root, self.root, 0
        while onward := [joint for joint in self.children[current] if below[_child(joint)] + _is_driven(joint) > 0]:
            onward.sort(key=lambda joint: below[_child(joint)] + _is_driven(joint), reverse=True)
            longest, *others = (below[_child(joint)] + _is_driven(joint) for joint in onward)
            jaws = others[:1] == [longest] and longest <= _JOINTS_OF_A_JAW
            if axes > 1 and (jaws or self._of_a_tool(onward[0], current)):
                break
            current, axes = _child(onward[0]), axes + _is_driven(onward[0])
            last = current if _is_driven(onward[0]) else last
        return last

    def only_path(self) -> list[ET.Element]:
        """Return the joints from the root to the last driven link, if there is only one path without a gripper."""
        driven = {link for link in self.reached[1:] if _is_driven(self.parent[link])}
        above: set[str] = set()  # links from which driven joints are reached
        for link in driven:
            above.update(_parent(joint) for joint in self.path_to(link))
        path: list[ET.Element] = []
        current = self.root
        while onward := [joint for joint in self.children[current] if _child(joint) in driven | above]:
            if len(onward) > 1:
                names = " and ".join(f"'{joint.get('name')}'" for joint in onward)
                raise ConfigError(
                    f"{self.where}: joints {names} both start at link '{current}' and lead to driven joints, but only"
                    f" one can belong to the arm: {name_the_tip(self.likely_tip())}"
                )
            path.append(onward[0])
            current = _child(onward[0])
        self._refuse_gripper(path)
        return path

    def _refuse_gripper(self, path: Sequence[ET.Element]) -> None:
        """Refuse to count a joint that seems to belong to a tool as an axis."""
        last, axes = "", 0
        for joint in path:
            name, child = joint.get("name", ""), _child(joint)
            why = self._of_a_tool(joint, _parent(joint)) if axes > 1 else ""
            if why:
                raise ConfigError(
                    f"{self.where}: joint '{name}' turns link '{child}' and {why}: it is not clear whether it is axis"
                    f" {axes + 1} of the arm; {name_the_tip(last)} without it, or --tip {child} with it"
                )
            if _is_driven(joint):
                axes, last = axes + 1, child

    def _of_a_tool(self, joint: ET.Element, above: str) -> str:
        """Return the reason why a driven joint seems to belong to a tool; empty if it does not."""
        if not _is_driven(joint):
            return ""
        if _GRIPPER.search(joint.get("name", "")) or _GRIPPER.search(_child(joint)):
            return "has the name of a gripper"
        while _HANDS.isdisjoint(_words(above)):
            if above not in self.parent or _is_driven(self.parent[above]):
                return ""
            above = _parent(self.parent[above])
        return f"is beyond '{above}'"

    def chain(self, path: Sequence[ET.Element]) -> Chain:
        """Return the chain along a path; all other links are fixed to it."""
        axes = self._axes(path)
        joints: list[Joint] = []
        links: list[MovedLink] = []
        unused: list[str] = []
        base_shapes: list[PlacedShape] = []
        frames: list[FixedFrame] = []
        for current in (self.root, *(_child(joint) for joint in axes)):
            fixed: list[tuple[tuple[Pose, ...], Inertial]] = []
            own_shapes: list[PlacedShape] = []
            fixed_shapes: list[PlacedShape] = []
            frames = []
            waiting: list[tuple[str, tuple[Pose, ...], bool]] = [(current, (), True)]
            while waiting:
                link, poses, rigid = waiting.pop()
                inertial = _inertial(self.links[link], link, self.where)
                if link != current:
                    if inertial is not None:
                        fixed.append((poses, inertial))
                    if rigid:
                        frames.append(FixedFrame(link, poses))
                shapes = list(shapes_of(self.links[link], link, self.where))
                unused += [f"link '{link}': {shape.what}" for _, shape in shapes if isinstance(shape, Unknown)]
                placed = [PlacedShape((*poses, pose), shape) for pose, shape in shapes]
                (own_shapes if link == current else fixed_shapes).extend(placed)
                for joint in self.children[link]:
                    if joint in axes:
                        joints.append(_turning(joint, poses, self.where))
                    else:
                        pose = origin(joint, f"joint '{joint.get('name')}'", self.where)
                        still = rigid and joint.get("type") == "fixed"
                        waiting.append((_child(joint), (*poses, pose), still))
            if current == self.root:
                base_shapes = own_shapes + fixed_shapes
            else:
                own = _inertial(self.links[current], current, self.where)
                links.append(MovedLink(current, own, tuple(fixed), tuple(own_shapes), tuple(fixed_shapes)))
        fixed_at_zero = [
            _kind(joint) for joint in self.parent.values() if joint.get("type") != "fixed" and joint not in axes
        ]
        return Chain(
            self.name,
            tuple(joints),
            tuple(links),
            tuple(base_shapes),
            tuple(fixed_at_zero),
            tuple(unused),
            tuple(sorted(frames, key=lambda frame: list(self.links).index(frame.name))),
        )

    def _axes(self, path: Sequence[ET.Element]) -> list[ET.Element]:
        """Return the driven joints of a path; no other movable joint may be between them."""
        driven = [row for row, joint in enumerate(path) if _is_driven(joint)]
        for joint in path[driven[0] : driven[-1]] if driven else ():
            if joint.get("type") != "fixed" and not _is_driven(joint):
                before = next(_child(each) for each in reversed(path[: list(path).index(joint)]) if _is_driven(each))
                what = f"is of type '{joint.get('type')}'" if joint.find("mimic") is None else "mimics another one"
                raise ConfigError(
                    f"{self.where}: joint '{joint.get('name')}' {what}; only revolute and fixed joints are supported"
                    f" between the axes of the arm; to end the arm before it, {name_the_tip(before)}"
                )
        return [path[row] for row in driven]


def flange_kind(link: str) -> str | None:
    """Return the usual flange name that a link name contains, without its prefix."""
    return next((name for name in FLANGES if _words(link)[-1] == name), None)


def _words(name: str) -> list[str]:
    return re.split(r"[-_/. ]", name.lower())


def _is_driven(joint: ET.Element) -> bool:
    return joint.get("type") in TURNING and joint.find("mimic") is None


def _kind(joint: ET.Element) -> str:
    """Return the name of a joint and its kind."""
    mimic = joint.find("mimic")
    what = joint.get("type", "of no type") if mimic is None else f"mimics '{mimic.get('joint', '')}'"
    return f"'{joint.get('name')}' ({what})"


def _named(root: ET.Element, tag: str, where: str) -> dict[str, ET.Element]:
    found: dict[str, ET.Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise ConfigError(f"{where}: a <{tag}> has no name; give each its own")
        if name in found:
            raise ConfigError(f"{where}: two {tag}s are named '{name}'; give each its own name")
        found[name] = element
    if not found:
        raise ConfigError(f"{where}: there is no <{tag}>; name the URDF of the arm")
    return found


def _reference(joint: ET.Element, tag: str, name: str, links: dict[str, ET.Element], where: str) -> str:
    element = joint.find(tag)
    link = element.get("link") if element is not None else None
    if link is None:
        raise ConfigError(f"{where}: joint '{name}': <{tag} link=\"..\"> is missing; add it")
    if link not in links:
        raise ConfigError(
            f"{where}: joint '{name}': <{tag}> names link '{link}', which does not exist; correct the name"
        )
    return link


def _child(joint: ET.Element) -> str:
    element = joint.find("child")
    return "" if element is None else element.get("link", "")


def _parent(joint: ET.Element) -> str:
    element = joint.find("parent")
    return "" if element is None else element.get("link", "")


def _turning(joint: ET.Element, poses: tuple[Pose, ...], where: str) -> Joint:
    name = joint.get("name", "")
    label = f"joint '{name}'"
    pose = origin(joint, label, where)
    axis_element = joint.find("axis")
    axis = (1.0, 0.0, 0.0) if axis_element is None else three(axis_element, "xyz", f"{label} <axis>", where, None)
    length = math.sqrt(sum(value * value for value in axis))
    if length < 1e-6:
        raise ConfigError(f"{where}: {label}: the axis is a zero vector; write its direction, such as 0 0 1")
    limit = joint.find("limit")
    lower, upper, velocity, effort = -math.inf, math.inf, math.nan, math.nan
    if limit is not None:
        velocity = number(limit, "velocity", f"{label} <limit>", where, 0.0) or math.nan
        effort = number(limit, "effort", f"{label} <limit>", where, 0.0) or math.nan
        if joint.get("type") == "revolute":
            lower = number(limit, "lower", f"{label} <limit>", where, -math.inf)
            upper = number(limit, "upper", f"{label} <limit>", where, math.inf)
            if lower > upper:
                raise ConfigError(f"{where}: {label} <limit>: lower {lower} is above upper {upper}; swap them")
            lower, upper = _softened(joint, lower, upper, where)
    x, y, z = (value / length for value in axis)
    return Joint(name, _child(joint), pose.xyz_m, pose.rpy_rad, (x, y, z), lower, upper, velocity, effort, poses)


def _softened(joint: ET.Element, lower: float, upper: float, where: str) -> tuple[float, float]:
    """Return the joint limits narrowed by a `<safety_controller>`; one without a range changes nothing."""
    soft = joint.find("safety_controller")
    if soft is None:
        return lower, upper
    label = f"joint '{joint.get('name')}' <safety_controller>"
    low = max(lower, number(soft, "soft_lower_limit", label, where, lower))
    high = min(upper, number(soft, "soft_upper_limit", label, where, upper))
    return (low, high) if low < high else (lower, upper)


def _inertial(link: ET.Element, name: str, where: str) -> Inertial | None:
    element = link.find("inertial")
    if element is None:
        return None
    label = f"link '{name}' <inertial>"
    mass_element, tensor = element.find("mass"), element.find("inertia")
    if mass_element is None or tensor is None:
        raise ConfigError(
            f"{where}: {label}: <mass> and <inertia> are both needed; without <inertial> the link counts as unknown"
        )
    mass = number(mass_element, "value", f"{label} <mass>", where, None)
    if mass < 0:
        raise ConfigError(f"{where}: {label}: mass {mass} kg is negative; correct it, or remove the inertial")
    xx, xy, xz, yy, yz, zz = (
        number(tensor, key, f"{label} <inertia>", where, None) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    return Inertial(origin(element, label, where), mass, (xx, xy, xz, yy, yz, zz))
