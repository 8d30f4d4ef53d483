"""Mass from one axis and a known lever, pose by pose: `m = N eta (tau_m,loaded - tau_m,bare) / (g k)`.

The ten-pose coefficient method of the paper on static load identification of the QH165 from servo output torque, eq.
(9); the paper takes g = 9.81 m/s2, here it is 9.80665. Only the mass comes out. Data that no body can have produced are
refused: torque beyond the rated one at rest, a torque that rises where the lever demands a fall, masses that disagree.

Torques of one approach direction are subtracted, since friction is in both. A gain that changes by `u` between the two
occasions changes the torque of links and load by `u tau`, in all poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from gateway.data.rows import Table
from gateway.errors import DataUnusable, InputError
from gateway.estimate.estimate import Estimate, describe_masses, disagree
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import (
    CONSTANTS,
    DRIFT,
    FRICTION,
    LINKS,
    LOAD_PARTS,
    NOISE,
    LoadEstimate,
    refused_load,
    unknown_load,
)
from gateway.identify.nuisance import change_covariance, gain_stds
from gateway.identify.prior_loads import BARE_LABEL, refuse_absent
from gateway.identify.rest.problem import BAND_UNSEEN
from gateway.result.result import Finding

Floats = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665
_SHORT = 0.05
_NORMAL = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Coefficient:
    """Inputs of the coefficient method: joint (from 1), lever column [m], gear, rated torque [Nm].

    A gear ratio or efficiency that is None is that of the cell.
    """

    joint: int
    lever: str
    gear_ratio: float | None = None
    gear_efficiency: float | None = None
    rated_torque_nm: float | None = None

    @property
    def gear(self) -> tuple[float, float]:
        """Return ratio and efficiency of the gear.

        Raises
        ------
        InputError
            One of them is neither stated nor that of a cell, or is zero.
        """
        if not (self.gear_ratio and self.gear_efficiency):
            raise InputError("--method coefficient needs --gear-ratio and --gear-efficiency, or --cell CELL")
        return self.gear_ratio, self.gear_efficiency


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    """One pose of one load: motor torque behind the gear over the ratio [Nm] by approach direction (0 = unknown), as
    measured [Nm], and lever [m].
    """

    pose: int
    behind_nm: dict[int, float]
    motor_nm: float
    lever_m: float


def estimate_coefficient(table: Table, knowledge: Knowledge, how: Coefficient | None) -> Estimate:
    """Estimate the mass of every unknown load by the coefficient method.

    Parameters
    ----------
    table : Table
        Rest rows with the lever in its extra column and motor torque (or joint torque) of the axis.
    knowledge : Knowledge
    how : Coefficient or None
        Inputs of the method; the lever replaces the geometry of the robot.

    Raises
    ------
    InputError
        No inputs of the method, no gear, no such column, or a known load that is not in the data.
    DataUnusable
        The axis was not measured, no reference, or no common pose.
    """
    if how is None:
        raise InputError("the coefficient method needs --axis and --lever")
    rest = table.take(~table.moving)
    if how.joint > table.axes:
        raise InputError(f"--axis {how.joint}: the data are of an arm of {table.axes} axes")
    if how.lever not in rest.extra:
        have = ", ".join(rest.extra) or "none"
        raise InputError(f"--lever {how.lever}: no such column in the data; extra columns there: {have}")
    labels = refuse_absent(rest.load, knowledge.stated_loads, rest.file)
    for label, load in knowledge.weighed.items():
        if load.mass_std_kg > 0.0:
            raise InputError(f"--known {label}: the coefficient method takes a known mass as exact; leave +-STD out")
    masses = {BARE_LABEL: 0.0} | {label: load.mass_kg for label, load in knowledge.stated_loads.items()}
    reference_label = next((label for label in masses if label in labels), None)
    if reference_label is None:
        raise DataUnusable("the coefficient method needs rows without load (load 'none') or with a known one")
    reference = {item.pose: item for item in _poses(rest, how, reference_label)}
    gain_std = float(gain_stds(knowledge.gain_std, table.axes)[how.joint - 1])
    change_std = float(np.sqrt(change_covariance(1, knowledge.change)[0, 0]))
    loads, findings = [], []
    for label in labels:
        if label == reference_label:
            continue
        reference_kg, stated_kg = masses[reference_label], masses.get(label)
        load, finding = _one(
            label, _poses(rest, how, label), reference, how, reference_kg, stated_kg, gain_std, change_std
        )
        loads += [load] if stated_kg is None or load.refused else []
        findings += finding
    if not loads:
        raise DataUnusable("every load in the data is known: there is nothing to estimate")
    findings.append(
        Finding(
            "info", f"J{how.joint}",
            f"the uncertainty of the mass does not include errors of the lever in column {how.lever}",
        )
    )  # fmt: skip
    unknown = np.full(table.axes, np.nan)
    return Estimate("coefficient", tuple(loads), unknown, unknown, findings=tuple(findings))


def _poses(rest: Table, how: Coefficient, label: str) -> list[_Pose]:
    """Return every pose of one load; repeated torques of one approach direction are averaged at the gear output."""
    axis, (ratio, efficiency) = how.joint - 1, how.gear
    here = rest.take(np.asarray(rest.load) == label)
    motor = here.motor_torque_nm[:, axis]
    motor = np.where(np.isfinite(motor), motor, here.tau_nm[:, axis] / ratio)
    side = np.sign(motor * here.direction[:, axis])
    behind = motor * np.where(side < 0, 1.0 / efficiency, efficiency)
    out = []
    for pose in np.unique(here.pose):
        rows = (here.pose == pose) & np.isfinite(motor)
        if not rows.any():
            continue
        lever = float(here.extra[how.lever][rows].mean())
        facing = here.direction[:, axis]
        by_side = {int(side): float(behind[rows & (facing == side)].mean()) for side in np.unique(facing[rows])}
        out.append(_Pose(int(pose), by_side, float(motor[rows].mean()), lever))
    if not out:
        raise DataUnusable(f"load '{label}': axis J{how.joint} has neither motor torque nor joint torque in the data")
    return out


def _one(
    label: str,
    poses: list[_Pose],
    reference: dict[int, _Pose],
    how: Coefficient,
    reference_kg: float,
    stated_kg: float | None,
    gain_std: float,
    change_std: float,
) -> tuple[LoadEstimate, list[Finding]]:
    """Estimate one load, or check it if its mass is stated, against the poses of the reference load.

    `gain_std` and `change_std` are the relative standard deviations of the gain, and of its change between occasions.
    """
    common = [item for item in poses if item.pose in reference]
    usable = [item for item in common if np.isfinite(item.lever_m) and abs(item.lever_m) > _SHORT]
    if not usable:
        raise DataUnusable(
            f"load '{label}' shares no pose with the reference in which the lever is longer than {_SHORT} m"
        )
    torques = {item.pose: _of_one_direction(item.behind_nm, reference[item.pose].behind_nm) for item in usable}
    opposite = [pose for pose, pair in torques.items() if pair is None]
    advice = "approach each pose from both directions, or under both loads from the same direction"
    what = f"poses {_names(opposite)} were approached from the direction opposite to that of the reference"
    if len(opposite) == len(usable):
        raise DataUnusable(
            f"load '{label}', J{how.joint}: {what}, so the difference holds twice the friction; {advice}"
        )
    findings = [Finding("warn", f"load {label}", f"{what} and were left out", advice)] if opposite else []
    usable = [item for item in usable if item.pose not in opposite]
    torque = np.array([pair for pair in torques.values() if pair is not None])
    change = torque[:, 0] - torque[:, 1]
    lever = np.array([item.lever_m for item in usable])
    per_nm = how.gear[0] / (STANDARD_GRAVITY_M_S2 * lever)
    mass = reference_kg + per_nm * change
    per_pose = {str(item.pose): float(value) for item, value in zip(usable, mass, strict=True)}
    contradictions = []
    over = [
        item.pose for item in common if how.rated_torque_nm is not None and abs(item.motor_nm) > how.rated_torque_nm
    ]
    if over:
        contradictions.append(
            f"{len(over)} of {len(common)} motor torques exceed the rated {how.rated_torque_nm:g} Nm"
            f" (poses {_names(over)})"
        )
    negative = [item.pose for item, value in zip(usable, mass, strict=True) if value < reference_kg]
    positive = [item.pose for item in usable if item.pose not in negative]
    against = negative if len(positive) >= len(negative) else positive
    if against:
        contradictions.append(f"in poses {_names(against)} the torque changes against the sign of the lever")
    if disagree(mass.tolist()):
        agreeing = max(int((np.abs(mass - value) <= 0.1 * abs(value)).sum()) for value in mass)
        contradictions.append(
            f"the poses alone would give {describe_masses(per_pose)}, and no mass fits more than"
            f" {agreeing} of {len(mass)} poses within 10 %"
        )
    if stated_kg is not None and not (np.abs(mass - stated_kg) <= 0.2 * stated_kg).any():
        contradictions.append(f"no pose comes near the stated {stated_kg:g} kg")
    if contradictions and (disagree(mass.tolist()) or len(contradictions) > 1):
        return refused_load(label, "its rows contradict each other: " + "; ".join(contradictions), per_pose), []
    findings += [Finding("warn", f"load {label}", text, "check the units and the run") for text in contradictions]
    friction_nm = 0.0
    if any(0 in {*item.behind_nm, *reference[item.pose].behind_nm} for item in usable):
        friction_nm = float(np.sqrt(2.0) * BAND_UNSEEN * np.sqrt(np.mean(torque**2)))
        what = "the approach directions are not known: friction is not separated from the load"
        findings.append(Finding("warn", f"load {label}", what, f"{advice}, and record it (column dir{how.joint})"))
    # mean mass over the poses, as in the paper; standard deviation from the scatter (Student's t)
    n, mass_kg, std_kg, budget = len(mass), float(mass.mean()), np.nan, {}
    if n > 1:
        # what all poses share is added: the torque constant, its change on each occasion, unknown friction
        weight_kg = np.mean(per_nm[:, None] * torque, axis=0)
        variances = {
            CONSTANTS: (gain_std * (mass_kg - reference_kg)) ** 2,
            LINKS: 0.0,
            FRICTION: (friction_nm * float(per_nm.mean())) ** 2,
            DRIFT: change_std**2 * float(weight_kg @ weight_kg),
            NOISE: (float(mass.std(ddof=1) / np.sqrt(n) * stdtrit(n - 1, 0.975)) / _NORMAL) ** 2,
        }
        variance = sum(variances.values())
        std_kg = float(np.sqrt(variance))
        budget = {source: value / variance for source, value in variances.items()} if variance > 0 else {}
    correlation = np.where(np.arange(16).reshape(4, 4) == 0, 1.0, np.nan)
    load = replace(unknown_load(label), mass_kg=mass_kg, mass_std_kg=std_kg, correlation=correlation)
    return replace(load, unidentifiable=LOAD_PARTS[1:], per_pose_mass_kg=per_pose, budget=budget), findings


def _of_one_direction(mine: dict[int, float], theirs: dict[int, float]) -> tuple[float, float] | None:
    """Return mean torques of the directions that both have, of all if one is unknown (0); None if all are opposite."""
    same = (mine.keys() & theirs.keys()) - {0}
    if not same and 0 not in {*mine, *theirs}:
        return None
    one, other = (float(np.mean([torque[side] for side in same or torque])) for torque in (mine, theirs))
    return one, other


def _names(poses: list[int]) -> str:
    return ", ".join(str(pose) for pose in poses)
