"""URDF of an arm: read into arrays, written from arrays.

The reader keeps what a simulator needs: the joint positions, axes and limits, and the inertials. Links on fixed joints
are merged into the moving link that carries them, and so are those on joints that no servo of the arm drives: slides,
joints that mimic others, joints beyond its last link; all of them are at zero. The writer gives every link its inertia
on principal axes, so that a physics engine uses it unchanged.
"""

from __future__ import annotations

import math
import xml.sax
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.sax.handler import ContentHandler
from xml.sax.xmlreader import AttributesImpl

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEWEST_AXES, MOST_AXES = 1, 8


class UrdfError(ValueError):
    """A robot description is not usable for the simulator; the message states the place and the error."""


@dataclass(frozen=True, slots=True)
class SimBody:
    """Inertial of one rigid body in its own frame; inertia about the centre of gravity."""

    mass_kg: float
    com_m: Array
    inertia_kg_m2: Array


@dataclass(frozen=True, slots=True)
class SimChain:
    """Revolute joints in a chain, one to eight.

    Attributes
    ----------
    name : robot name
    placement : (N, 4, 4) parent link frame -> joint frame at angle 0
    axis : (N, 3) unit axis of rotation in the joint frame
    bodies : inertials in link frames, None where the file gives none
    lower_rad, upper_rad, effort_nm, velocity_rad_s : (N,) limits of the file
    """

    name: str
    placement: Array
    axis: Array
    bodies: tuple[SimBody | None, ...]
    lower_rad: Array
    upper_rad: Array
    effort_nm: Array
    velocity_rad_s: Array


def translation(x: float, y: float, z: float) -> Array:
    """Pose (4, 4) moved by x, y, z [m]."""
    result = np.eye(4)
    result[:3, 3] = x, y, z
    return result


def turn(axis: str, angle_rad: Array | float) -> Array:
    """Pose (..., 4, 4) turned about an axis of the frame, "x", "y" or "z", by an angle [rad]."""
    angle = np.asarray(angle_rad, dtype=float)
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    result = np.zeros((*angle.shape, 4, 4))
    result[..., range(4), range(4)] = 1.0
    result[..., first, first] = result[..., second, second] = np.cos(angle)
    result[..., second, first] = np.sin(angle)
    result[..., first, second] = -np.sin(angle)
    return result


def turn_about(vector_rad: Array) -> Array:
    """Rotation (3, 3) by the length of a vector (3,) [rad] about its direction; Rodrigues' formula."""
    angle = float(np.linalg.norm(vector_rad))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def rotation_rpy(rpy_rad: Sequence[float] | Array) -> Array:
    """Rotation matrix of roll, pitch, yaw about the fixed axes x, y, z (URDF convention), shape (3, 3)."""
    roll, pitch, yaw = rpy_rad
    return (turn("z", yaw) @ turn("y", pitch) @ turn("x", roll))[:3, :3]


def rpy_of(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a rotation matrix of shape (3, 3)."""
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if abs(math.cos(pitch)) < 1e-9:
        return math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        pitch,
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


def combine(first: SimBody, second: SimBody) -> SimBody:
    """One rigid body of two, both in the same frame (parallel axis theorem, exact)."""
    mass = first.mass_kg + second.mass_kg
    if mass <= 0.0:
        return SimBody(0.0, np.zeros(3), first.inertia_kg_m2 + second.inertia_kg_m2)
    com = (first.mass_kg * first.com_m + second.mass_kg * second.com_m) / mass
    inertia = np.zeros((3, 3))
    for body in (first, second):
        arm = body.com_m - com
        inertia += body.inertia_kg_m2 + body.mass_kg * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return SimBody(mass, com, inertia)


class _AsWritten(ContentHandler):
    """Builds elements with their names as they are written, whether their prefixes are declared or not."""

    def __init__(self) -> None:
        super().__init__()
        self.builder = ElementTree.TreeBuilder()

    def startElement(self, name: str, attrs: AttributesImpl) -> None:  # noqa: N802  (name of the standard library)
        self.builder.start(name, dict(attrs.items()))

    def endElement(self, name: str) -> None:  # noqa: N802
        self.builder.end(name)


def read_chain(text: str | bytes, where: str, tip: str | None = None) -> SimChain:
    """Read a URDF of one to eight revolute joints in a chain, which ends at the link `tip` where that is given.

    Raises
    ------
    UrdfError : not XML, not a chain of one to eight revolute joints, or a number that is none
    """
    elements = _AsWritten()
    try:
        xml.sax.parseString(text, elements)
    except (xml.sax.SAXException, LookupError, ValueError) as error:
        raise UrdfError(f"{where}: not readable as XML: {error}") from error
    try:
        return _chain(elements.builder.close(), where, tip)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, UrdfError):
            raise
        raise UrdfError(f"{where}: {error}") from error


def _chain(robot: ElementTree.Element, where: str, tip: str | None) -> SimChain:
    joints = robot.findall("joint")
    links = {link.attrib["name"]: link for link in robot.findall("link")}
    children = {_ref(joint, "child") for joint in joints}
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise UrdfError(f"{where}: {len(roots)} links have no parent, exactly one base is needed")
    by_parent: dict[str, list[ElementTree.Element]] = {}
    for joint in joints:
        by_parent.setdefault(_ref(joint, "parent"), []).append(joint)

    if tip is not None and tip not in links:
        raise UrdfError(f"{where}: there is no link '{tip}', the stated tip of the arm")
    driven = _driven(joints, tip)
    found: list[tuple[ElementTree.Element, Array]] = []
    bodies: list[SimBody | None] = []
    stack: list[tuple[str, Array, int]] = [(roots[0], np.eye(4), -1)]
    while stack:
        name, frame, carrier = stack.pop()
        if carrier >= 0:
            bodies[carrier] = _merged(bodies[carrier], moved(_inertial(links[name]), frame))
        for joint in by_parent.get(name, []):
            placed = frame @ _origin(joint)
            if joint not in driven:
                stack.append((_ref(joint, "child"), placed, carrier))
                continue
            if carrier != len(found) - 1:
                raise UrdfError(f"{where}: joint '{joint.attrib['name']}' branches off, a single chain is needed")
            found.append((joint, placed))
            bodies.append(None)
            stack.append((_ref(joint, "child"), np.eye(4), len(found) - 1))
    if not FEWEST_AXES <= len(found) <= MOST_AXES:
        raise UrdfError(f"{where}: {len(found)} revolute joints, {FEWEST_AXES} to {MOST_AXES} are needed")
    limits = np.array([_limits(joint) for joint, _ in found])
    return SimChain(
        name=robot.attrib.get("name", "robot"),
        placement=np.array([placed for _, placed in found]),
        axis=np.array([_axis(joint) for joint, _ in found]),
        bodies=tuple(bodies),
        lower_rad=limits[:, 0],
        upper_rad=limits[:, 1],
        effort_nm=limits[:, 2],
        velocity_rad_s=limits[:, 3],
    )


def _driven(joints: list[ElementTree.Element], tip: str | None) -> list[ElementTree.Element]:
    """Joints that servos turn: revolute, of their own motion, and above the last link where that is named."""
    driven = [
        joint for joint in joints if joint.attrib["type"] in ("revolute", "continuous") and joint.find("mimic") is None
    ]
    if tip is None:
        return driven
    above, by_child = [], {_ref(joint, "child"): joint for joint in joints}
    while tip in by_child:
        above.append(by_child.pop(tip))
        tip = _ref(above[-1], "parent")
    return [joint for joint in driven if joint in above]


def _ref(joint: ElementTree.Element, tag: str) -> str:
    element = joint.find(tag)
    if element is None:
        raise UrdfError(f"joint '{joint.attrib.get('name')}' has no <{tag}>")
    return element.attrib["link"]


def _numbers(text: str, count: int) -> Array:
    values = np.array([float(part) for part in text.split()])
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise UrdfError(f"'{text}' is not {count} finite numbers")
    return values


def _origin(element: ElementTree.Element) -> Array:
    frame = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        frame[:3, 3] = _numbers(origin.attrib.get("xyz", "0 0 0"), 3)
        frame[:3, :3] = rotation_rpy(_numbers(origin.attrib.get("rpy", "0 0 0"), 3))
    return frame


def _axis(joint: ElementTree.Element) -> Array:
    element = joint.find("axis")
    axis = _numbers(element.attrib["xyz"], 3) if element is not None else np.array([1.0, 0.0, 0.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise UrdfError(f"joint '{joint.attrib['name']}' has an axis of length 0")
    return axis / length


def _limits(joint: ElementTree.Element) -> tuple[float, float, float, float]:
    element = joint.find("limit")
    values = element.attrib if element is not None else {}
    return (
        float(values.get("lower", -math.inf)),
        float(values.get("upper", math.inf)),
        float(values.get("effort", math.inf)),
        float(values.get("velocity", math.inf)),
    )


def _inertial(link: ElementTree.Element) -> SimBody | None:
    inertial = link.find("inertial")
    if inertial is None:
        return None
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    if mass is None or tensor is None:
        raise UrdfError(f"link '{link.attrib['name']}': <inertial> needs <mass> and <inertia>")
    xx, xy, xz, yy, yz, zz = (float(tensor.attrib[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    own = SimBody(
        float(mass.attrib["value"]), np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=float)
    )
    return moved(own, _origin(inertial))


def moved(body: SimBody | None, frame: Array) -> SimBody | None:
    """Transform a body from a frame (4, 4) to the frame's parent."""
    if body is None:
        return None
    rotation = frame[:3, :3]
    return SimBody(body.mass_kg, rotation @ body.com_m + frame[:3, 3], rotation @ body.inertia_kg_m2 @ rotation.T)


def _merged(first: SimBody | None, second: SimBody | None) -> SimBody | None:
    if first is None or second is None:
        return first or second
    return combine(first, second)


def write_chain(chain: SimChain, comment: str = "") -> str:
    """URDF text of a chain; every body must be known.

    Raises
    ------
    UrdfError : a body is missing, its mass or its principal moments are not positive
    """
    lines = ['<?xml version="1.0"?>', *([f"<!-- {comment} -->"] if comment else [])]
    lines += [f'<robot name="{chain.name}">', *_link_lines("base_link", SimBody(100.0, np.zeros(3), 10.0 * np.eye(3)))]
    for i, body in enumerate(chain.bodies):
        lines += [*_link_lines(f"link_{i + 1}", body), *_joint_lines(chain, i)]
    return "\n".join([*lines, "</robot>", ""])


def _joint_lines(chain: SimChain, i: int) -> list[str]:
    limits = (chain.lower_rad[i], chain.upper_rad[i], chain.effort_nm[i], chain.velocity_rad_s[i])
    keys = ("lower", "upper", "effort", "velocity")
    stated = [f'{key}="{value:.6g}"' for key, value in zip(keys, limits, strict=True) if math.isfinite(value)]
    return [
        f'  <joint name="joint_{i + 1}" type="{"revolute" if len(stated) == 4 else "continuous"}">',
        f'    <parent link="{f"link_{i}" if i else "base_link"}"/>',
        f'    <child link="link_{i + 1}"/>',
        f"    {_origin_tag(chain.placement[i])}",
        f'    <axis xyz="{_text(chain.axis[i])}"/>',
        f"    <limit {' '.join(stated)}/>" if stated else "",
        "  </joint>",
    ]


def _link_lines(name: str, body: SimBody | None) -> list[str]:
    if body is None:
        raise UrdfError(f"{name} has no inertial: mass, centre of gravity and inertia of every link are needed")
    moments, frame = principal_axes(body)
    if body.mass_kg <= 0 or moments.min() <= 0 or 2 * moments.max() > moments.sum() * (1 + 1e-9):
        raise UrdfError(f"{name}: mass {body.mass_kg} kg with principal moments {moments} kg m2 is not a rigid body")
    values = zip(("ixx", "iyy", "izz"), moments, strict=True)
    tensor = " ".join(f'{key}="{value:.12g}"' for key, value in values)
    return [
        f'  <link name="{name}">',
        "    <inertial>",
        f"      {_origin_tag(frame)}",
        f'      <mass value="{body.mass_kg:.12g}"/>',
        f'      <inertia {tensor} ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
        "  </link>",
    ]


def principal_axes(body: SimBody) -> tuple[Array, Array]:
    """Principal moments (3,) [kg m2] and the frame (4, 4) of the principal axes at the centre of gravity."""
    frame = np.eye(4)
    frame[:3, 3] = body.com_m
    tensor = 0.5 * (body.inertia_kg_m2 + body.inertia_kg_m2.T)
    off_diagonal = tensor - np.diag(np.diag(tensor))
    if np.abs(off_diagonal).max() <= 1e-12 * np.abs(tensor).max():
        return np.diag(tensor).copy(), frame
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    frame[:3, :3] = axes
    return moments, frame


def _origin_tag(frame: Array) -> str:
    return f'<origin xyz="{_text(frame[:3, 3])}" rpy="{_text(rpy_of(frame[:3, :3]))}"/>'


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in values)
