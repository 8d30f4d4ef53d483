"""URDF text -> the chain of its moving joints, as written: no arithmetic, only structure and refusal.

Documents with a DTD are refused before anything is expanded, so that no entity can blow up.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from xml.parsers import expat

from gateway.errors import ConfigError
from gateway.model.urdf_elements import Pose, Three, number, origin, three
from gateway.model.urdf_shapes import Shape, shapes_of

MAX_CHARACTERS = 20_000_000
MAX_DEPTH = 100
TURNING = ("revolute", "continuous")


@dataclass(frozen=True, slots=True)
class Inertial:
    """`<inertial>`: tensor as (xx, xy, xz, yy, yz, zz) [kg m2] about the centre of mass, in the frame of `pose`."""

    pose: Pose
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Joint:
    """A turning joint; `fixed_before` are the fixed joints between the moved link before it and itself."""

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
    """A shape of `<collision>` and the poses that lead to it from the moved link."""

    poses: tuple[Pose, ...]
    shape: Shape


@dataclass(frozen=True, slots=True)
class MovedLink:
    """A link that a joint moves: its own inertial and shapes, and those of links fixed to it with the poses between."""

    name: str
    own: Inertial | None
    fixed: tuple[tuple[tuple[Pose, ...], Inertial], ...]
    own_shapes: tuple[PlacedShape, ...]
    fixed_shapes: tuple[PlacedShape, ...]


@dataclass(frozen=True, slots=True)
class Chain:
    """Turning joints from the root to the end, the link each of them moves, and the shapes of what stands still."""

    name: str
    joints: tuple[Joint, ...]
    links: tuple[MovedLink, ...]
    base_shapes: tuple[PlacedShape, ...]


def read_chain(text: str, where: str) -> Chain:
    """The chain of turning joints of a URDF; raises ConfigError naming file and element."""
    root = _parse(text, where)
    if root.tag != "robot":
        raise ConfigError(f"{where}: the outermost element is <{root.tag}>, a URDF starts with <robot>")
    links = _named(root, "link", where)
    joints = _named(root, "joint", where)
    children: dict[str, list[ET.Element]] = {name: [] for name in links}
    moved: set[str] = set()
    for name, joint in joints.items():
        parent, child = (_reference(joint, tag, name, links, where) for tag in ("parent", "child"))
        if child in moved:
            raise ConfigError(f"{where}: link '{child}' is the child of two joints; the arm must be a chain")
        moved.add(child)
        children[parent].append(joint)
    roots = [name for name in links if name not in moved]
    if len(roots) != 1:
        raise ConfigError(f"{where}: expected one root link, found {len(roots)}: {', '.join(roots) or 'a closed loop'}")
    return _walk(root.get("name", "robot"), roots[0], links, children, where)


def _walk(
    name: str, root: str, links: dict[str, ET.Element], children: dict[str, list[ET.Element]], where: str
) -> Chain:
    chain_joints: list[Joint] = []
    chain_links: list[MovedLink] = []
    base_shapes: list[PlacedShape] = []
    current: str | None = root
    while current is not None:
        fixed: list[tuple[tuple[Pose, ...], Inertial]] = []
        own_shapes: list[PlacedShape] = []
        fixed_shapes: list[PlacedShape] = []
        onward: list[Joint] = []
        waiting: list[tuple[str, tuple[Pose, ...]]] = [(current, ())]
        while waiting:
            link, poses = waiting.pop()
            inertial = _inertial(links[link], link, where)
            if inertial is not None and link != current:
                fixed.append((poses, inertial))
            placed = [PlacedShape((*poses, pose), shape) for pose, shape in shapes_of(links[link], link, where)]
            (own_shapes if link == current else fixed_shapes).extend(placed)
            for joint in children[link]:
                if joint.get("type") == "fixed":
                    waiting.append((_child(joint), (*poses, origin(joint, f"joint '{joint.get('name')}'", where))))
                else:
                    onward.append(_turning(joint, poses, where))
        if len(onward) > 1:
            raise ConfigError(
                f"{where}: joints '{onward[0].name}' and '{onward[1].name}' both turn on link '{current}';"
                " the arm must be one chain, fix the joints that do not belong to it"
            )
        if current == root:
            base_shapes = own_shapes + fixed_shapes
        else:
            own = _inertial(links[current], current, where)
            chain_links.append(MovedLink(current, own, tuple(fixed), tuple(own_shapes), tuple(fixed_shapes)))
        chain_joints += onward
        current = onward[0].child if onward else None
    return Chain(name, tuple(chain_joints), tuple(chain_links), tuple(base_shapes))


def _parse(text: str, where: str) -> ET.Element:
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"{where}: {len(text)} characters are no robot description (limit {MAX_CHARACTERS})")
    depth = 0

    def refuse(*_: object) -> None:
        raise ConfigError(f"{where}: a document type or entity declaration is not allowed in a URDF; remove it")

    def down(*_: object) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ConfigError(f"{where}: elements are nested more than {MAX_DEPTH} deep")

    def up(*_: object) -> None:
        nonlocal depth
        depth -= 1

    scanner = expat.ParserCreate()
    scanner.StartDoctypeDeclHandler = refuse
    scanner.EntityDeclHandler = refuse
    scanner.StartElementHandler = down
    scanner.EndElementHandler = up
    try:
        scanner.Parse(text, True)
        return ET.fromstring(text)
    except (expat.ExpatError, ET.ParseError, ValueError, LookupError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{where}: not readable as XML: {error}") from error


def _named(root: ET.Element, tag: str, where: str) -> dict[str, ET.Element]:
    found: dict[str, ET.Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise ConfigError(f"{where}: a <{tag}> has no name")
        if name in found:
            raise ConfigError(f"{where}: two {tag}s are named '{name}'")
        found[name] = element
    if not found:
        raise ConfigError(f"{where}: there is no <{tag}>")
    return found


def _reference(joint: ET.Element, tag: str, name: str, links: dict[str, ET.Element], where: str) -> str:
    element = joint.find(tag)
    link = element.get("link") if element is not None else None
    if link is None:
        raise ConfigError(f"{where}: joint '{name}': <{tag} link=\"..\"> is missing")
    if link not in links:
        raise ConfigError(f"{where}: joint '{name}': <{tag}> names link '{link}', which does not exist")
    return link


def _child(joint: ET.Element) -> str:
    element = joint.find("child")
    return "" if element is None else element.get("link", "")


def _turning(joint: ET.Element, poses: tuple[Pose, ...], where: str) -> Joint:
    name = joint.get("name", "")
    label = f"joint '{name}'"
    if joint.get("type") not in TURNING:
        raise ConfigError(
            f"{where}: {label} is of type '{joint.get('type')}'; only revolute and fixed joints are handled"
        )
    if joint.find("mimic") is not None:
        raise ConfigError(f"{where}: {label}: <mimic> is not handled; every axis needs its own drive")
    pose = origin(joint, label, where)
    axis_element = joint.find("axis")
    axis = (1.0, 0.0, 0.0) if axis_element is None else three(axis_element, "xyz", f"{label} <axis>", where, None)
    length = math.sqrt(sum(value * value for value in axis))
    if length < 1e-6:
        raise ConfigError(f"{where}: {label}: the axis is a zero vector")
    limit = joint.find("limit")
    lower, upper, velocity, effort = -math.inf, math.inf, math.nan, math.nan
    if limit is not None:
        velocity = number(limit, "velocity", f"{label} <limit>", where, 0.0) or math.nan
        effort = number(limit, "effort", f"{label} <limit>", where, 0.0) or math.nan
        if joint.get("type") == "revolute":
            lower = number(limit, "lower", f"{label} <limit>", where, -math.inf)
            upper = number(limit, "upper", f"{label} <limit>", where, math.inf)
            if lower > upper:
                raise ConfigError(f"{where}: {label} <limit>: lower {lower} is above upper {upper}")
    x, y, z = (value / length for value in axis)
    return Joint(name, _child(joint), pose.xyz_m, pose.rpy_rad, (x, y, z), lower, upper, velocity, effort, poses)


def _inertial(link: ET.Element, name: str, where: str) -> Inertial | None:
    element = link.find("inertial")
    if element is None:
        return None
    label = f"link '{name}' <inertial>"
    mass_element, tensor = element.find("mass"), element.find("inertia")
    if mass_element is None or tensor is None:
        raise ConfigError(
            f"{where}: {label}: <mass> and <inertia> are both needed (or no inertial: then it is unknown)"
        )
    mass = number(mass_element, "value", f"{label} <mass>", where, None)
    if mass < 0:
        raise ConfigError(f"{where}: {label}: mass {mass} kg is negative")
    xx, xy, xz, yy, yz, zz = (
        number(tensor, key, f"{label} <inertia>", where, None) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    return Inertial(origin(element, label, where), mass, (xx, xy, xz, yy, yz, zz))
