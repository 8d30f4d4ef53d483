"""Golden tables: what was measured, what the owner states, and the truth."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from benchmarks.blind.cells import knowledge_of as blind_knowledge
from benchmarks.blind.drawn_arm import LOADED_S, VISIT_S
from benchmarks.blind.drawn_cell import draw_cell
from benchmarks.blind.mechanisms import MECHANISMS
from benchmarks.blind.nature import knowledge_of
from benchmarks.blind.strict import There, there
from benchmarks.conflict.conditions import CONDITIONS as CONDITIONS_OF_CONFLICT
from benchmarks.moving.cells import TIERS
from benchmarks.moving.cells import draw_cell as draw_moving_cell
from benchmarks.nature.levels import CONDITIONS
from benchmarks.nature.nature_cell import NatureCell, draw_effect_cell
from benchmarks.nature.nature_cell import draw_cell as draw_nature_cell
from gateway.data.table import Table
from gateway.estimate import estimate
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import Robot, robot_from_urdf
from sim.draw import draw_load
from sim.offline import PlannedVisit, measure
from sim.plant import Payload
from tests.data.arms import peer_of, urdf_of
from tests.support.rigs.tables import make_table, simulated_table

Floats = NDArray[np.float64]

#: Seeds of the comparison start here: no other benchmark or test draws them.
FIRST_SEED = 70000
#: Numbers of axes of the random arms.
AXES = (2, 3, 4, 5, 7, 8)
RANDOM_POSES = 10
#: Seeded tables of each kind.
SEEDS = 24


@dataclass(frozen=True, slots=True)
class Case:
    """One table with what is stated and what is true.

    Attributes
    ----------
    condition : str
    seed : int
    table : Table
    robot : Robot
    knowledge : what is stated besides the table
    loads : label -> true mass [kg] and centre of gravity [m] (4,)
    effects : effects that are present; None where no list exists
    """

    condition: str
    seed: int
    table: Table
    robot: Robot
    knowledge: Knowledge
    loads: Mapping[str, Floats]
    effects: tuple[There, ...] | None = field(default=())


def _parameters(load: Payload) -> Floats:
    return np.array([load.mass_kg, *load.com_m])


def _drawn(seed: int) -> Case:
    """Rest poses from both sides, bare and loaded; one or two effects in half of the arms."""
    cell = draw_cell(seed)
    robot = robot_from_urdf(cell.arm.urdf, f"seed {seed}")
    table = simulated_table(cell.measure(cell.visits))
    pairs = zip(cell.truth.effects, cell.truth.strengths, strict=True)
    effects = tuple(there([str(e["name"])], e["joints"], s) for e, s in pairs)  # type: ignore[arg-type]
    loads = {"tool": _parameters(cell.arm.loads["tool"])}
    return Case("", seed, table, robot, blind_knowledge(cell), loads, None if cell.truth.kind == "off" else effects)


def _one_sided(seed: int) -> Case:
    """The same arms, each pose approached from one side."""
    drawn_cell = _drawn(seed)
    side = np.random.default_rng([seed, 5]).integers(0, 2, drawn_cell.table.pose.max() + 1)
    keep = (drawn_cell.table.direction[:, 0] > 0) == (side[drawn_cell.table.pose] > 0)
    # friction of each axis by direction is in every one-sided table, and may be named
    friction = tuple(there(["static_friction"], [axis + 1], 0.0) for axis in range(drawn_cell.table.axes))
    effects = None if drawn_cell.effects is None else (*drawn_cell.effects, *friction)
    return replace(drawn_cell, table=drawn_cell.table.take(keep), effects=effects)


def _several(seed: int) -> Case:
    """An unloaded arm and two loads, no effect."""
    cell = draw_cell(seed)
    rng = np.random.default_rng([seed, 6])
    arm = cell.arm
    tool = arm.loads["tool"]
    loads = {"tool": tool, "other": replace(draw_load("other", tool.mass_kg, rng), label="other")}
    after = max(visit.time_s for visit in cell.visits) + LOADED_S
    bare = [visit for visit in cell.visits if visit.load == "none"]
    more = [PlannedVisit(v.pose, "other", after + VISIT_S * k, v.q_rad) for k, v in enumerate(bare)]
    columns = measure(arm.chain, arm.plant, [*cell.visits, *more], loads, arm.protocol, rng)
    robot = robot_from_urdf(arm.urdf, f"seed {seed}")
    truth = {label: _parameters(load) for label, load in loads.items()}
    return Case("", seed, simulated_table(columns), robot, blind_knowledge(cell), truth)


def _of_nature(cell: NatureCell) -> Case:
    table = simulated_table(cell.measure(cell.visits)[0])
    robot = robot_from_urdf(cell.stated.urdf, f"seed {cell.seed}")
    pairs = zip(cell.effects, cell.strengths, strict=True)
    effects = tuple(there(MECHANISMS[e.mechanism], e.joints, s) for e, s in pairs)
    loads = {"tool": _parameters(cell.arm.tool)}
    return Case("", cell.seed, table, robot, knowledge_of(cell), loads, effects)


def _nature(seed: int) -> Case:
    """Arms drawn by nature, nothing beyond nuisance parameters; conditions in turn."""
    return _of_nature(draw_nature_cell(seed, CONDITIONS[seed % len(CONDITIONS)]))


def _nature_effects(seed: int) -> Case:
    """Arms drawn by nature with something beyond it."""
    return _of_nature(draw_effect_cell(seed))


def _stored_bare(seed: int) -> Case:
    """Loaded poses of a nature arm, against a stored identification of the unloaded arm."""
    drawn_cell = _nature(seed)
    bare_rows = np.asarray(drawn_cell.table.load) == "none"
    bare = estimate(drawn_cell.table.take(bare_rows), drawn_cell.robot, drawn_cell.knowledge).bare
    return replace(
        drawn_cell,
        table=drawn_cell.table.take(~bare_rows),
        knowledge=replace(drawn_cell.knowledge, bare=bare),
    )


def _axes(seed: int) -> Case:
    """Random chains of 2 to 8 axes: torque by pinocchio, friction band, noise; links known to 5 %."""
    axes = AXES[seed % len(AXES)]
    rng = np.random.default_rng([seed, 8])
    text = urdf_of(rng, axes=axes)
    robot = robot_from_urdf(text, f"{axes} axes")
    model, data = peer_of(text)
    for i in range(1, axes + 1):
        body = model.inertias[i]
        lever = body.lever + 0.05 * np.linalg.norm(body.lever) * rng.standard_normal(3)
        model.inertias[i] = pinocchio.Inertia(body.mass * (1.0 + 0.05 * rng.standard_normal()), lever, body.inertia)
    mass, com = float(rng.uniform(3.0, 15.0)), rng.uniform(-0.15, 0.15, 3)
    bare, flange = pinocchio.Inertia(model.inertias[axes]), pinocchio.Inertia(mass, com, 0.01 * mass * np.eye(3))
    poses = rng.uniform(-2.5, 2.5, (RANDOM_POSES, axes))
    still = np.zeros(axes)
    rows, torque, scale = [], [], None
    for place, label in enumerate(("none", "tool")):
        model.inertias[axes] = bare if label == "none" else bare + flange
        tau = np.array([pinocchio.rnea(model, data, q, still, still) for q in poses])
        scale = np.abs(tau).max(axis=0) + 1.0 if scale is None else scale
        for side in (1.0, -1.0):
            left = 1.0 - 0.3 * rng.uniform(size=tau.shape)
            noise = 0.002 * rng.standard_normal(tau.shape)
            torque.append(tau + scale * (side * 0.03 * left + noise))
            start = VISIT_S * RANDOM_POSES * place + 8.0 * (side < 0)
            rows += [(label, k, start + VISIT_S * k, side) for k in range(RANDOM_POSES)]
    load, pose, time_s, direction = zip(*rows, strict=True)
    table = make_table(
        np.array(load), np.array(pose), np.tile(poses, (4, 1)), np.vstack(torque),
        time=np.array(time_s), direction=np.array(direction), count=100,
    )  # fmt: skip
    truth = {"tool": np.array([mass, *com])}
    return Case("", seed, table, robot, Knowledge(link_std=0.05, gain_std=(0.0,) * axes), truth)


def _moving(seed: int) -> Case:
    """A bare and a loaded run along an excitation trajectory; what is known of the torque constants in turn."""
    cell = draw_moving_cell(seed, TIERS[seed % len(TIERS)], periods=2, rate_hz=50.0)
    robot = robot_from_urdf(cell.stated.urdf, f"seed {seed}")
    return Case("", seed, cell.table(), robot, cell.knowledge, {"tool": _parameters(cell.arm.tool)})


#: Conditions in the order in which they alternate.
MAKERS: Mapping[str, Callable[[int], Case]] = {
    "rest": _drawn,
    "one-sided": _one_sided,
    "several loads": _several,
    "bare stored": _stored_bare,
    "2 to 8 axes": _axes,
    "nature": _nature,
    "nature, effects": _nature_effects,
    "moving": _moving,
}

#: Tables with a wrong statement, one a condition; tables in files.
CONFLICT, FILES = "conflict", "file"
_EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
_QH165 = "--method coefficient --axis 2 --lever x_k2_m --gear-ratio 210 --gear-efficiency 0.8 --rated-torque 23.875"
#: Files: table, model and further options; `{data}` is the folder of SERVO_GATEWAY_DATA.
_OF_FILES: Mapping[str, tuple[str, ...]] = {
    "hidden_balancer": (f"{_EXAMPLES}/python/hidden_balancer.csv", "--cell", f"{_EXAMPLES}/large/cell.toml"),
    "tx40": ("{data}/tx40/run_1_first.csv", "--robot", "{data}/tx40/robot.urdf"),
    "kr300": ("{data}/kr300/run_A.csv", "--robot", "{data}/kr300/robot.urdf"),
    "ur10": ("{data}/ur10/run_1_first.csv", "--robot", "{data}/ur10/robot.urdf"),
    "qh165": ("{data}/qh165/table2.csv", *_QH165.split()),
}


def names() -> list[str]:
    """Names of all tables, KIND/NUMBER; kinds alternate, so that any first N hold all of them."""
    seeded = [f"{kind}/{FIRST_SEED + k}" for k in range(SEEDS) for kind in MAKERS]
    files = [
        name for name, words in _OF_FILES.items() if os.environ.get("SERVO_GATEWAY_DATA") or "{data}" not in words[0]
    ]
    typed = [f"{FILES}/{name}" for name in files] + [f"{CONFLICT}/{name}" for name in CONDITIONS_OF_CONFLICT]
    step = len(seeded) / len(typed)
    placed = [(k, name) for k, name in enumerate(seeded)] + [(step * k + 0.5, name) for k, name in enumerate(typed)]
    return [name for _, name in sorted(placed)]


def words_of(command: str, name: str) -> list[str]:
    """Return the words of a command on files; the coefficient method is an estimate."""
    words = [word.format(data=os.environ.get("SERVO_GATEWAY_DATA", "")) for word in _OF_FILES[name]]
    return ["estimate" if "--method" in words else command, *words]
