"""What is measured on an arm at rest: friction, gears, constants, repeatability and noise on top of its gravity torque.

The torque of an axis that came to rest in direction d, with gravity torque tau::

    inner = tau + s d c                   s: share of the friction band c that acts behind the gear
    outer = inner (1 + n)                 where the motor drives (d inner > 0), else inner (1 - n'), n' about n (1 - n)
    read  = (1 + g) (outer + (1 - s) d c + bias)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.conflict.arm import AXES, Floats, LinkMasses, RatedArm, draw_arm, gravity_torque

#: Seconds of a visit from one side, and between two blocks.
VISIT_S, CHANGE_S = 30.0, 300.0
#: Relative standard deviation of the torque constants; half of its variance is common to all axes.
GAIN_STD = 0.03
SAMPLES = 200


@dataclass(slots=True)
class GearFriction:
    """GearFriction of every axis (6,): band [Nm], losses of a driving gear, their share when driven, and the rest.

    Attributes
    ----------
    coulomb_nm, driving, driven : losses when the motor drives and when it is driven back
    inner_share : of the band, behind the gear
    bias_nm : of the half-sum
    cold, warm_s : the band is (1 + cold exp(-t / warm_s)) times as large at time t
    """

    coulomb_nm: Floats
    driving: Floats
    driven: Floats
    inner_share: Floats
    bias_nm: Floats
    cold: Floats
    warm_s: Floats


@dataclass(slots=True)
class LoadBlock:
    """Visits of all poses under one load: label, run, start [s], factors (6,) on the torque that is read, true loads.

    `load` is the key of the true load, `later` that of the second half of the poses where it is another one.
    """

    label: str
    run: str
    start_s: float
    gain: Floats = field(default_factory=lambda: np.ones(AXES))
    load: str = ""
    later: str = ""


@dataclass(slots=True)
class ConflictCell:
    """One arm with everything that is true, what is stated of it, and how it is measured; conditions change it.

    Attributes
    ----------
    rng : of the measurement
    change : generator for what a condition draws, apart from `rng`
    arm, true, stated, gravity_up : links as they are and as the URDF has them; -1 where gravity points up
    loads : label -> mass [kg] and centre [m] in the last link (4,)
    poses_rad : (n, 6)
    blocks : in the order in which they are measured
    gain : (6,) of the torque constants
    friction : GearFriction
    repeat_rad, scatter : error of a pose, and of a visit's torque as a share of the band
    zero_rad : (6,) true joint angle minus the one reported
    reading : factor on every torque at a share 0 .. 1 of the run
    extra_nm : torque (n, 6) beside links and load, of joint angles and of the size of each axis's torque
    hose : share of the load that acts as a hose on the last links when the load is on
    lopsided : how much larger the band is in the positive direction under load
    sides : approach directions of each pose
    rough : what real arms have besides: cogging, outlier visits, friction by position
    columns, options, length_unit, stored_bare : what is handed over: table, options, unit of the URDF, bare run apart
    outliers : visits that are far off on one axis
    """

    rng: np.random.Generator
    change: np.random.Generator
    arm: RatedArm
    true: LinkMasses
    stated: LinkMasses
    loads: dict[str, Floats]
    poses_rad: Floats
    blocks: list[LoadBlock]
    gain: Floats
    friction: GearFriction
    size_nm: Floats
    gravity_up: float = 1.0
    repeat_rad: float = 1e-4
    scatter: float = 0.05
    zero_rad: Floats = field(default_factory=lambda: np.zeros(AXES))
    reading: Callable[[Floats], Floats] = np.ones_like
    extra_nm: Callable[[Floats, Floats], Floats] | None = None
    hose: float = 0.0
    lopsided: float = 0.0
    one_sided: bool = False
    rough: bool = False
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    options: list[str] = field(default_factory=list)
    length_unit: float = 1.0
    stored_bare: bool = False
    outliers: int = 0


def draw_cell(seed: int, variant: str = "floor") -> ConflictCell:
    """Draw an arm, its loads, poses and friction; the same seed is the same arm under every condition."""
    rng = np.random.default_rng([seed, 1])
    arm = draw_arm(rng, variant if variant in ("wall", "ceiling") else "floor")
    labels = ("tool", "part") if variant == "two loads" else ("tool",)
    reach = 0.45 * arm.rated_kg**0.34
    offset = reach * np.array([0.08, 0.08, 0.10])
    loads = {x: np.array([arm.rated_kg * rng.uniform(0.3, 1.0), *(offset * rng.normal(size=3))]) for x in labels}
    count = 6 if variant == "6 poses" else 12
    poses = rng.uniform(-0.9, 0.9, (count, AXES)) * arm.geometry.limit_rad
    block_s = 2 * count * VISIT_S + CHANGE_S
    blocks = [LoadBlock(label, "run", k * block_s, load=label) for k, label in enumerate(("none", *labels))]
    size = np.sqrt(np.mean(gravity_torque(arm.geometry, arm.true, poses, loads["tool"]) ** 2, axis=0))
    size = np.maximum(size, 0.1 * np.array([size[1], size[1], size[1], size[4], size[4], size[4]]))
    size[0] = 0.4 * size[1]
    common, own = rng.standard_normal(), rng.standard_normal(AXES)
    return ConflictCell(
        rng=np.random.default_rng([seed, 2]),
        change=np.random.default_rng([seed, 3]),
        arm=arm,
        true=arm.true.copy(),
        stated=arm.stated.copy(),
        loads=loads,
        poses_rad=poses,
        blocks=blocks,
        gain=GAIN_STD * (common + own) / np.sqrt(2.0),
        friction=_draw_friction(rng, size),
        size_nm=size,
    )


def _draw_friction(rng: np.random.Generator, size_nm: Floats) -> GearFriction:
    driving = rng.uniform(0.02, 0.10, AXES)
    coulomb = size_nm * rng.uniform(0.05, 0.15, AXES)
    return GearFriction(
        coulomb_nm=coulomb,
        driving=driving,
        driven=driving * (1.0 - driving) * (1.0 + 0.1 * rng.standard_normal(AXES)),
        inner_share=rng.uniform(0.0, 1.0, AXES),
        bias_nm=0.1 * coulomb * rng.standard_normal(AXES),
        cold=rng.uniform(0.0, 0.4, AXES),
        warm_s=60.0 * rng.uniform(5.0, 60.0, AXES),
    )


def measure(cell: ConflictCell) -> dict[str, np.ndarray]:
    """Columns of the measured table: every pose of every block from both sides, or from one at random."""
    parts = [_measured_block(cell, block) for block in cell.blocks]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _measured_block(cell: ConflictCell, block: LoadBlock) -> dict[str, np.ndarray]:
    count, rng = len(cell.poses_rad), cell.rng
    pose = np.repeat(np.arange(count), 2)
    side = np.tile([1.0, -1.0], count)
    time_s = block.start_s + VISIT_S * np.arange(2 * count)
    if cell.one_sided:
        keep = 2 * np.arange(count) + rng.integers(0, 2, count)
        pose, side, time_s = pose[keep], side[keep], time_s[keep]
    q = cell.poses_rad[pose]
    load = cell.loads.get(block.load)
    at = q + cell.zero_rad + cell.repeat_rad * rng.standard_normal(q.shape)
    tau = gravity_torque(cell.arm.geometry, cell.true, at, load, cell.gravity_up)
    if block.later:
        other = gravity_torque(cell.arm.geometry, cell.true, at, cell.loads[block.later], cell.gravity_up)
        tau = np.where(pose[:, None] < count / 2, tau, other)
    if load is not None and cell.hose:
        tau = tau + _hose(cell, at, load)
    if cell.extra_nm is not None:
        tau = tau + cell.extra_nm(at, cell.size_nm)
    read = _after_friction(cell, tau, side[:, None], time_s[:, None], load is not None)
    sample_nm = 0.01 * cell.size_nm
    read = read + sample_nm / np.sqrt(SAMPLES) * rng.standard_normal(q.shape)
    if cell.rough:
        read = read + _rough(cell, at)
    last_s = cell.blocks[-1].start_s + 2 * count * VISIT_S
    read = read * (1.0 + cell.gain) * block.gain * cell.reading(time_s / last_s)[:, None]
    columns = {"run": np.full(len(pose), block.run), "load": np.full(len(pose), block.label), "pose": pose}
    columns["time_s"] = time_s
    for i in range(AXES):
        columns |= {f"q{i + 1}_rad": q[:, i], f"dir{i + 1}": side.astype(int), f"tau{i + 1}_nm": read[:, i]}
        columns[f"tau{i + 1}_std_nm"] = np.full(len(pose), sample_nm[i])
    return columns | {"n": np.full(len(pose), SAMPLES)}


def _after_friction(cell: ConflictCell, tau: Floats, side: Floats, time_s: Floats, loaded: bool) -> Floats:
    of = cell.friction
    band = of.coulomb_nm * (1.0 + of.cold * np.exp(-time_s / of.warm_s))
    band = band * (1.0 + cell.scatter * cell.rng.standard_normal(tau.shape))
    if loaded:
        band = band * (1.0 + np.where(side > 0, cell.lopsided, 0.0))
    inner = tau + side * of.inner_share * band
    outer = np.where(side * inner > 0, inner * (1.0 + of.driving), inner * (1.0 - of.driven))
    return outer + side * (1.0 - of.inner_share) * band + of.bias_nm


def _hose(cell: ConflictCell, q: Floats, load: Floats) -> Floats:
    """A hose to the tool: dead weight on link 3 and springs on the wrist, growing with the load's weight."""
    weight = np.array([cell.hose * load[0], *(0.5 * cell.arm.geometry.length_m[2] * np.array([1.0, 0.0, 0.5]))])
    bare = LinkMasses(np.zeros(AXES), np.zeros((AXES, 3)))
    bare.mass_kg[2], bare.com_m[2] = weight[0], weight[1:]
    gravity_nm = gravity_torque(cell.arm.geometry, bare, q, None, cell.gravity_up)
    springs = np.where(np.arange(AXES) >= 3, cell.hose * cell.size_nm, 0.0)
    return gravity_nm + springs * np.sin(q)


def _rough(cell: ConflictCell, q: Floats) -> Floats:
    """Cogging, a band that changes with the position, and one visit in fifty that is far off on one axis."""
    rng, band = cell.rng, cell.friction.coulomb_nm
    cogging = 0.03 * band * np.sin(120.0 * q + rng.uniform(0, 2 * np.pi, AXES))
    outliers = rng.uniform(size=len(q)) < 0.02
    cell.outliers += int(outliers.sum())
    far = np.zeros(q.shape)
    far[outliers, rng.integers(0, AXES, int(outliers.sum()))] = rng.uniform(3.0, 8.0, int(outliers.sum()))
    return cogging + far * band * rng.choice([-1.0, 1.0], q.shape)
