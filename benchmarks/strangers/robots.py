"""Robot descriptions of strangers: an arm of known joints, and around it what exporters, grippers and editors add.

A file counts as right when it is read as its arm with the torque that pinocchio computes. It also counts as right when
it is refused with a message that says what to type. A tip link that is asked for is then typed, and the arm has to be
right with it.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio

from benchmarks.figure import figure
from gateway.errors import ConfigError
from gateway.model.placeholders import model_remarks
from gateway.model.regressor import regressor
from gateway.model.robot import Robot, robot_from_urdf
from gateway.model.urdf_text import read_urdf
from gateway.motion.body import solids_of
from tests.data.arms import link_parameters, states, urdf_of

FILES = 400
GRAVITY = (0.0, 0.0, -9.80665)


@dataclass(slots=True)
class Case:
    """A file as a stranger brings it.

    Attributes
    ----------
    clean : str
        The same robot, written plainly: for pinocchio.
    text : str
        As the stranger has it.
    axes : int
        Of the arm: joint_1 to joint_N.
    encoding : str
    files : mapping of name to content beside it
    named : list of str
        Regular expressions of what has to be named where it is read.
    refused : list of str
        Regular expressions, one of which the refusal has to match; empty = it has to be read.
    """

    clean: str
    text: str
    axes: int
    encoding: str = "utf-8"
    files: dict[str, bytes | None] = field(default_factory=dict)
    named: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


Change = Callable[[Case, np.random.Generator], None]

INERTIAL = (
    '<inertial><origin xyz="0.02 0.01 0.05" rpy="0.1 0.2 0.3"/><mass value="{:.3f}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.04"/></inertial>'
)


def joint(rng: np.random.Generator, name: str, parent: str, kind: str, child: str, inner: str = "") -> str:
    """A joint with the link that it carries."""
    xyz, rpy = rng.uniform(-0.2, 0.2, 3), rng.uniform(-1, 1, 3)
    return (
        f'<link name="{child}">{INERTIAL.format(rng.uniform(0.2, 3))}</link><joint name="{name}" type="{kind}">'
        f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}"'
        f' rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/><axis xyz="0 1 0"/>'
        f'<limit lower="-1" upper="1" effort="20" velocity="1"/>{inner}</joint>'
    )


def add(case: Case, more: str) -> None:
    """More links and joints, in both texts."""
    case.clean = case.clean.replace("</robot>", more + "</robot>")
    case.text = case.text.replace("</robot>", more + "</robot>")


def of_last(case: Case) -> str:
    return f"link_{case.axes}"


def balancer(case: Case, rng: np.random.Generator) -> None:
    mimic = f'<mimic joint="joint_2" multiplier="{rng.uniform(-1, 1):.2f}"/>'
    add(case, joint(rng, "balancer", "link_1", "revolute", "cylinder", mimic))
    add(case, joint(rng, "rod_joint", "cylinder", "prismatic", "rod", '<mimic joint="joint_2"/>'))
    case.named += [r"fixed at zero:.*'balancer' \(mimics 'joint_2'\)"]


def sliding_fingers(case: Case, rng: np.random.Generator) -> None:
    add(case, joint(rng, "hand_joint", of_last(case), "fixed", "hand"))
    add(case, joint(rng, "finger_1", "hand", "prismatic", "left"))
    add(case, joint(rng, "finger_2", "hand", "prismatic", "right", '<mimic joint="finger_1"/>'))
    case.named += [r"fixed at zero:.*'finger_1' \(prismatic\)"]


def turning_jaw(case: Case, rng: np.random.Generator) -> None:
    name = rng.choice(["jaw", "finger_joint", "left_gripper", "knuckle_joint"])
    add(case, joint(rng, str(name), of_last(case), "revolute", "part"))
    case.refused += [rf"--tip {of_last(case)}\b", "--tip"]


def jaw_on_a_flange(case: Case, rng: np.random.Generator) -> None:
    face = str(rng.choice(["tool0", "flange", "ee_link", "robot_tool0", "hand"]))
    add(case, joint(rng, "face", of_last(case), "fixed", face))
    add(case, joint(rng, "motor", face, "revolute", "part"))
    case.refused += [rf"--tip {of_last(case)}\b", "--tip"]


def two_jaws(case: Case, rng: np.random.Generator) -> None:
    add(case, joint(rng, "left", of_last(case), "revolute", "left_part"))
    add(case, joint(rng, "right", of_last(case), "revolute", "right_part"))
    case.refused += ["--tip"]


def rocker(case: Case, rng: np.random.Generator) -> None:
    add(case, joint(rng, "rocker", "link_1", "revolute", "rocker_link"))
    case.refused += [rf"--tip {of_last(case)}\b", "--tip"]


def track(case: Case, rng: np.random.Generator) -> None:
    kind = str(rng.choice(["prismatic", "fixed"]))
    carried = joint(rng, "track", "world", kind, "base").replace(
        re.search(r'<link name="base">', joint(rng, "t", "w", kind, "base"))[0],
        '<link name="base">',  # type: ignore[index]
    )
    for name in ("clean", "text"):
        text = getattr(case, name).replace('<link name="base"/>', '<link name="world"/>' + carried)
        setattr(case, name, text)
    case.named += [r"fixed at zero:.*'track'"] if kind != "fixed" else []


def frames(case: Case, rng: np.random.Generator) -> None:
    add(case, joint(rng, "to_flange", of_last(case), "fixed", "flange"))
    add(case, joint(rng, "to_tool0", "flange", "fixed", "tool0"))


def latin(case: Case, _rng: np.random.Generator) -> None:
    case.text = '<?xml version="1.0" encoding="ISO-8859-1"?>' + case.text.replace("<robot ", "<!-- Gerät --><robot ")
    case.encoding = "iso-8859-1"


def wide(case: Case, _rng: np.random.Generator) -> None:
    case.text = '<?xml version="1.0" encoding="UTF-16"?>' + case.text
    case.encoding = "utf-16"


def marked(case: Case, _rng: np.random.Generator) -> None:
    case.encoding = "utf-8-sig"


def undeclared(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace("</robot>", "<!-- Gerät --></robot>")
    case.encoding = "iso-8859-1"
    case.refused += ['save the file as UTF-8, or write its encoding.*encoding="ISO-8859-1"']


def prefix(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace("</robot>", "<gazebo><sensor:camera a='1'/></gazebo></robot>")


def zero_shape(case: Case, rng: np.random.Generator) -> None:
    shape = rng.choice(
        ['<box size="0 0 0"/>', '<sphere radius="0"/>', '<cylinder radius="0.1"/>', '<box size="a b c"/>']
    )
    collide(case, str(shape), rng)
    case.named += [r"collision geometry left out: link 'link_\d': <"]


def collide(case: Case, shape: str, rng: np.random.Generator) -> None:
    head = f'<link name="link_{rng.integers(1, case.axes + 1)}">'
    case.text = case.text.replace(head, f"{head}<collision><geometry>{shape}</geometry></collision>")


def good_mesh(case: Case, rng: np.random.Generator) -> None:
    corners = rng.normal(size=(int(rng.integers(20, 20_000)), 3, 3)) * 0.05
    rows = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    rows["c"] = corners
    case.files["link.stl"] = bytes(80) + len(corners).to_bytes(4, "little") + rows.tobytes()
    collide(case, '<mesh filename="link.stl"/>', rng)


def missing_mesh(case: Case, rng: np.random.Generator) -> None:
    collide(case, '<mesh filename="package://nowhere/gone.stl"/>', rng)
    case.named += [r"gone\.stl cannot be read"]


def pipe_mesh(case: Case, rng: np.random.Generator) -> None:
    case.files["pipe.stl"] = None
    collide(case, '<mesh filename="pipe.stl"/>', rng)
    case.named += [r"pipe\.stl is not used"]


def same_masses(case: Case, _rng: np.random.Generator) -> None:
    for name in ("clean", "text"):
        text = re.sub(r'(<link name="link_\d">.*?<mass value=")[^"]*"', r'\g<1>1"', getattr(case, name))
        setattr(case, name, text)


def same_efforts(case: Case, _rng: np.random.Generator) -> None:
    case.named += ["a placeholder: the URDF states the same effort"]


def no_body(case: Case, _rng: np.random.Generator) -> None:
    for name in ("clean", "text"):
        setattr(case, name, re.sub(r'(name="link_1">.*?ixx=")[^"]*', r"\g<1>90", getattr(case, name), count=1))
    case.named += ["a placeholder: the inertia of"]


def soft_limits(case: Case, _rng: np.random.Generator) -> None:
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="1" k_velocity="1"/></joint>'
    case.text = case.text.replace("</joint>", soft, 1)


def macro(case: Case, rng: np.random.Generator) -> None:
    macros = ('<xacro:property name="h" value="1"/>', '<xacro:include filename="$(find arm)/arm.xacro"/>')
    case.text = case.text.replace("<link", f"{rng.choice(macros)}<link", 1)
    case.refused += [r"this is a xacro file: expand it first: `xacro \S+ > \S+\.urdf`"]


def expression(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace('upper="3"', 'upper="${pi}"', 1)
    case.refused += [r"this is a xacro file: expand it first: `xacro \S+ > \S+\.urdf`"]


def expanded(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')


def mjcf(case: Case, _rng: np.random.Generator) -> None:
    case.text = "<mujoco><worldbody/></mujoco>"
    case.refused = [r"MJCF.*convert it first"]


def sdf(case: Case, _rng: np.random.Generator) -> None:
    case.text = '<sdf version="1.6"><model name="a"/></sdf>'
    case.refused = [r"SDF.*convert it first"]


def millimetres(case: Case, _rng: np.random.Generator) -> None:
    def thousandfold(found: re.Match[str]) -> str:
        return f'xyz="{" ".join(str(1000 * float(value)) for value in found[1].split())}" rpy'

    case.text = re.sub(r'xyz="([^"]*)" rpy', thousandfold, case.text)
    case.refused += ["millimetres.*export it in metres"]


def grams(case: Case, _rng: np.random.Generator) -> None:
    case.text = re.sub(r'<mass value="([^"]*)"', lambda found: f'<mass value="{1000 * float(found[1])}"', case.text)
    case.refused += ["grams.*export it in kilograms"]


def slide_between(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace('name="joint_3" type="revolute"', 'name="joint_3" type="prismatic"')
    case.refused = [r"between the axes of the arm.*--tip link_2"]


def comma(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace('upper="3"', 'upper="3,1"', 1)
    case.refused += [r"joint_1' <limit> upper: '3,1' is not a number; write a number"]


def misspelled(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace('name="joint_2" type="revolute"', 'name="joint_2" type="Revolute"')
    case.refused = [r"'joint_2' is of type 'Revolute', which must be one of revolute.*correct it"]


def lost_link(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text.replace('<child link="link_2"/>', '<child link="link2"/>')
    case.refused = [r"names link 'link2', which does not exist; correct"]


def cut_off(case: Case, _rng: np.random.Generator) -> None:
    case.text = case.text[: len(case.text) * 2 // 3]
    case.refused = [r"not readable as XML.*name the URDF of the arm"]


#: What changes the robot, at most two of them in a file; what ends in a refusal counts as one of them.
BODIES: tuple[Change, ...] = (
    balancer, sliding_fingers, turning_jaw, jaw_on_a_flange, two_jaws, rocker, track, frames,
)  # fmt: skip
#: What changes how it is written, at most two of them in a file.
WRITING: tuple[Change, ...] = (
    latin, wide, marked, prefix, zero_shape, good_mesh, missing_mesh, pipe_mesh, same_masses, same_efforts, no_body,
    soft_limits, expanded,
)  # fmt: skip
#: What makes it unreadable, one in a file.
WRONG: tuple[Change, ...] = (
    undeclared, macro, expression, mjcf, sdf, millimetres, grams, slide_between, comma, misspelled, lost_link, cut_off,
)  # fmt: skip
#: Changes that say the same thing of a file, or contradict each other.
APART = (
    {sliding_fingers, turning_jaw, jaw_on_a_flange, two_jaws, frames},
    {latin, wide, marked},
    {same_masses, grams},
)


def draw(seed: int) -> tuple[Case, tuple[str, ...]]:
    """A file and the names of what is odd about it."""
    rng = np.random.default_rng(seed)
    axes = int(rng.choice([5, 6, 6, 6, 6, 7]))
    text = urdf_of(rng, axes=axes)
    case = Case(text, text, axes)
    chosen: list[Change] = []
    for group, most in ((BODIES, 2), (WRITING, 2), (WRONG, 1)):
        count = int(rng.integers(0, most + 1)) if group is not WRONG else int(rng.random() < 0.25)
        for row in rng.permutation(len(group))[:count]:
            change = group[row]
            if not any(change in apart and apart & set(chosen) for apart in APART):
                chosen.append(change)
    if any(change in WRONG for change in chosen):  # what is wrong is found first
        chosen = [change for change in chosen if change not in BODIES and change not in APART[1]]
    for change in chosen:
        change(case, rng)
    return case, tuple(change.__name__ for change in chosen)


def judge(case: Case, folder: Path) -> tuple[str, float]:
    """Why a file is not handled right (empty: it is), and the largest relative error of its torque."""
    path = folder / "robot.urdf"
    path.write_bytes(case.text.encode(case.encoding))
    for name, content in case.files.items():
        if content is None:
            os.mkfifo(folder / name)
        else:
            (folder / name).write_bytes(content)
    try:
        if not case.refused:
            return right(robot_from_urdf(read_urdf(path), str(path)), case)
        robot = robot_from_urdf(read_urdf(path), str(path))
    except ConfigError as error:
        said = " ".join([str(error), *getattr(error, "__notes__", [])])
    else:
        return f"read with {robot.axes} axes, to be refused", 0.0
    if not any(re.search(expected, said) for expected in case.refused) or "robot.urdf" not in said:
        return f"refused: {said}", 0.0
    tip = re.search(r"--tip (\w+)", said)
    if tip is None or "between the axes" in said:
        return "", 0.0
    return right(robot_from_urdf(read_urdf(path), str(path), tip[1]), case)


def right(robot: Robot, case: Case) -> tuple[str, float]:
    """As `judge`, of what was read."""
    expected = tuple(f"joint_{number}" for number in range(1, case.axes + 1))
    if robot.joint_names != expected:
        return f"read as {robot.joint_names}", 0.0
    unusable = (line for shapes in robot.shapes for line in solids_of(shapes, robot.source)[1])
    said = "\n".join([*model_remarks(robot), *unusable])
    unnamed = [pattern for pattern in case.named if not re.search(pattern, said)]
    return (f"not named: {unnamed[0]}" if unnamed else ""), torque_error(robot, case.clean)


def torque_error(robot: Robot, clean: str) -> float:
    """Largest error of the torque against pinocchio, over the largest torque."""
    full_model = pinocchio.buildModelFromXML(clean)
    locked = [full_model.getJointId(name) for name in full_model.names[1:] if name not in robot.joint_names]
    model = pinocchio.buildReducedModel(full_model, locked, pinocchio.neutral(full_model))
    model.gravity.linear = np.array(GRAVITY)
    data = model.createData()
    q, qd, qdd = states(1, 3, robot.axes)
    ours = np.asarray(regressor(robot, q, qd, qdd, GRAVITY)) @ link_parameters(robot)
    theirs = np.array([pinocchio.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def figures() -> dict[str, dict]:
    """Figures of all files; what is not handled right is said on stderr."""
    handled, read, errors, seconds = 0, 0, [0.0], [0.0]
    for seed in range(FILES):
        case, odd = draw(seed)
        with tempfile.TemporaryDirectory() as folder:
            began_s = time.process_time()
            try:
                why, error = judge(case, Path(folder))
            except Exception as failed:  # a crash is a miss like any other
                why, error = f"{type(failed).__name__}: {failed}", 0.0
            seconds.append(time.process_time() - began_s)
        if why:
            print(f"robot {seed} ({', '.join(odd)}): {why}", file=sys.stderr, flush=True)
        handled += not why
        read += error > 0.0
        errors.append(error)
    return {
        "robot files": figure(FILES, f">= {FILES}"),
        "robot files: share read as the true chain, or refused with what to type": figure(
            100.0 * handled / FILES, "== 100", unit="%"
        ),
        "robot files: read, at once or with the tip that was to be typed": figure(read, ">= 1"),
        "robot files: largest error of the torque against pinocchio, relative": figure(max(errors), "<= 1e-12"),
        "robot files: slowest, processor time": figure(max(seconds), "<= 2", unit="s"),
    }
