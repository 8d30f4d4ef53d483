"""The conditions: what is wrong with a cell's statements or readings; one line each in `CONDITIONS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.conflict.arm import AXES, LinkMasses, scattered
from benchmarks.conflict.plant import GAIN_STD, ConflictCell, LoadBlock

Change = Callable[[ConflictCell], None]


def unchanged(cell: ConflictCell) -> None:
    """Nothing is wrong."""


@dataclass(frozen=True, slots=True)
class WrongStatement:
    """What is changed before the measurement and in the table afterwards.

    `clean`: a warning is a false alarm; `open`: no interval can hold, as with two loads of one label.
    """

    before: Change = unchanged
    after: Change = unchanged
    clean: bool = False
    open: bool = False


def masses(of: Callable[[ConflictCell], object]) -> WrongStatement:
    """The URDF states these masses."""

    def change(cell: ConflictCell) -> None:
        cell.stated.mass_kg[:] = np.asarray(of(cell), dtype=float)

    return WrongStatement(change)


def links(std: float = 0.05, factor: float = 1.0, gains: float | None = None) -> WrongStatement:
    """The links scatter by `std` about `factor` times the URDF's masses; the gains by `gains`, each on its own."""

    def change(cell: ConflictCell) -> None:
        true = scattered(cell.change, cell.arm.geometry, cell.arm.stated, std)
        cell.true = LinkMasses(factor * true.mass_kg, true.com_m)
        if gains is not None:
            cell.gain = gains * cell.change.standard_normal(AXES)

    return WrongStatement(change)


def no_motors(cell: ConflictCell) -> None:
    """The URDF has the castings of links 2, 3, 5 and 6; motors of 30 % of each link are missing."""
    for link in (1, 2, 4, 5):
        cell.stated.mass_kg[link] *= 0.7
        cell.stated.com_m[link] += 0.1 * cell.arm.geometry.length_m[link] * np.array([1.0, 0.0, 0.0])


def one_zero(cell: ConflictCell) -> None:
    """One of links 2 to 4 has mass 0."""
    cell.stated.mass_kg[int(cell.change.integers(1, 4))] = 0.0


def drift(percent: float, exponential: bool = False) -> WrongStatement:
    """The reading falls by so many percent over the run."""
    last = -percent / 100.0

    def reading(share: np.ndarray) -> np.ndarray:
        shape = (1.0 - np.exp(-3.0 * share)) / (1.0 - np.exp(-3.0)) if exponential else share
        return 1.0 + last * shape

    def change(cell: ConflictCell) -> None:
        cell.reading = reading

    return WrongStatement(change)


def other_gains(percent: float, stored: bool = False) -> WrongStatement:
    """Between bare and loaded runs the gains change by so many percent an axis; the bare run may be a stored one."""

    def change(cell: ConflictCell) -> None:
        for block in cell.blocks[1:]:
            block.gain = 1.0 + percent / 100.0 * cell.change.standard_normal(AXES)
        cell.stored_bare = stored

    return WrongStatement(change)


def gains(common: float, own: float) -> WrongStatement:
    """Torque constants that are off by a common share, and scatter."""

    def change(cell: ConflictCell) -> None:
        cell.gain = common + own * cell.change.standard_normal(AXES)

    return WrongStatement(change)


def option(*words: str) -> WrongStatement:
    """An option that claims more than is true."""
    return WrongStatement(lambda cell: cell.options.extend(words))


def flipped(*names: str, one: bool = True) -> WrongStatement:
    """Columns of one axis, 2 to 6, or of all axes with the other sign."""

    def change(cell: ConflictCell) -> None:
        axes = [int(cell.change.integers(2, AXES + 1))] if one else range(1, AXES + 1)
        for column in (name.format(axis) for axis in axes for name in names):
            cell.columns[column] = -cell.columns[column]

    return WrongStatement(after=change)


def torque_times(of: Callable[[ConflictCell], object]) -> WrongStatement:
    """Torque columns hold the torque of each axis times a factor: another unit, a current, or the motor's torque."""

    def change(cell: ConflictCell) -> None:
        factor = np.broadcast_to(np.asarray(of(cell), dtype=float), AXES)
        for axis, name in ((axis, f"tau{axis + 1}{kind}_nm") for axis in range(AXES) for kind in ("", "_std")):
            cell.columns[name] = factor[axis] * cell.columns[name]

    return WrongStatement(after=change)


def motor_side(cell: ConflictCell) -> object:
    """One over a gear ratio of 50 to 160 on each axis."""
    return 1.0 / cell.change.uniform(50.0, 160.0, AXES)


def amperes(cell: ConflictCell) -> object:
    """Current instead of torque: one over torque constants of 0.3 to 2 Nm/A and a gear ratio."""
    return np.asarray(motor_side(cell)) / cell.change.uniform(0.3, 2.0, AXES)


def quarter_turns(cell: ConflictCell) -> None:
    """The zero of one of axes 2 to 5 is 90, 180 or 270 degrees from that of the URDF.

    Axis 6 would turn the load alone, and half a turn of axis 2 is the same as gravity that is upside down.
    """
    axis = int(cell.change.integers(2, AXES))
    quarters = cell.change.choice([1, 3] if axis == 2 else [1, 2, 3])
    cell.columns[f"q{axis}_rad"] = cell.columns[f"q{axis}_rad"] + np.pi / 2 * quarters


def set_to(**values: object) -> WrongStatement:
    """Fields of the cell."""

    def change(cell: ConflictCell) -> None:
        for name, value in values.items():
            setattr(cell, name, value)

    return WrongStatement(change)


def known(factor: float, constants: float = 1.0, centre: bool = True, clean: bool = False) -> WrongStatement:
    """A second load is stated as known, with `factor` times its mass; all constants are wrong by one factor."""

    def change(cell: ConflictCell) -> None:
        com = cell.loads["tool"][1:]
        cell.loads["weight"] = np.array([0.6 * cell.arm.rated_kg, *com])
        last = cell.blocks[-1]
        step_s = last.start_s - cell.blocks[-2].start_s
        cell.blocks.append(LoadBlock("weight", "run", last.start_s + step_s, load="weight"))
        stated = ",".join(f"{x:.9g}" for x in (factor * cell.loads["weight"][0], *(com if centre else ())))
        cell.options += ["--known", f"weight={stated}"]
        cell.gain = constants * (1.0 + cell.gain) - 1.0

    return WrongStatement(change, clean=clean)


def undeclared_wave(cell: ConflictCell) -> None:
    """A torque sin(2 q2) on axis 2 of a tenth of its size: nothing in a model of links."""
    cell.extra_nm = lambda q, size: np.outer(np.sin(2.0 * q[:, 1]), 0.1 * size * (np.arange(AXES) == 1))


def zeros(degrees: float) -> WrongStatement:
    """Joint zeros scatter by so many degrees."""

    def change(cell: ConflictCell) -> None:
        cell.zero_rad = np.radians(degrees) * cell.change.standard_normal(AXES)

    return WrongStatement(change)


def heavier_later(cell: ConflictCell) -> None:
    """A second run under the same label has a tool 10 % heavier."""
    last = cell.blocks[-1]
    cell.loads["tool, later"] = cell.loads["tool"] * np.array([1.1, 1.0, 1.0, 1.0])
    step_s = last.start_s - cell.blocks[-2].start_s
    cell.blocks.append(LoadBlock("tool", "run 2", last.start_s + step_s, load="tool, later"))


def lighter_later(cell: ConflictCell) -> None:
    """Half of what is on the flange is lost in the middle of the loaded poses."""
    mass, *com = cell.loads["tool"]
    cell.loads["tool, half"] = np.array([0.5 * mass, *com])
    cell.blocks[1].later = "tool, half"


def coupled(cell: ConflictCell) -> None:
    """Column q3 holds q3 + q2, as controllers with a parallel linkage show it."""
    cell.columns["q3_rad"] = cell.columns["q3_rad"] + cell.columns["q2_rad"]


def other_size(cell: ConflictCell) -> None:
    """The URDF is that of a robot of the same family with lengths larger by 15 %."""
    cell.length_unit = 1.15
    cell.stated.mass_kg *= 1.15**3


def one_posture(cell: ConflictCell) -> None:
    """One pose under all loads."""
    cell.poses_rad = cell.poses_rad[:1]


def nature(cell: ConflictCell) -> None:
    """What real arms have besides: cogging, outlier visits, worse repeatability, more scatter between visits."""
    cell.rough, cell.repeat_rad, cell.scatter = True, 4e-4, 0.08


CONDITIONS: Mapping[str, WrongStatement] = {
    "clean": WrongStatement(clean=True),
    "clean, nature": WrongStatement(nature, clean=True),
    "URDF masses 0": masses(lambda cell: np.zeros(AXES)),
    "URDF masses 1 kg": masses(lambda cell: np.ones(AXES)),
    "URDF masses x3": masses(lambda cell: 3.0 * cell.stated.mass_kg),
    "links 15 % heavier": links(factor=1.15),
    "links scatter 15 %": links(0.15),
    "links scatter 30 %": links(0.30),
    "one link 0 kg": WrongStatement(one_zero),
    "URDF masses x0.8, gains 10 %": links(factor=1.25, gains=0.10),
    "motors left out": WrongStatement(no_motors),
    "URDF masses 10 g": masses(lambda cell: np.full(AXES, 0.01)),
    "drift 1 %": drift(1.0),
    "drift 2 %": drift(2.0),
    "drift 4 %": drift(4.0),
    "drift 4 %, exponential": drift(4.0, exponential=True),
    "gains change 1 %": other_gains(1.0),
    "gains change 2 %": other_gains(2.0),
    "stored bare, gains 1 %": other_gains(1.0, stored=True),
    "constants +6 %": gains(0.06, GAIN_STD / np.sqrt(2.0)),
    "constants scatter 10 %": gains(0.0, 0.10),
    "inertials exact": option("--inertials", "exact"),
    "torque-gain exact": option("--torque-gain", "exact"),
    "torque sign, one axis": flipped("tau{}_nm"),
    "torque sign, all": flipped("tau{}_nm", one=False),
    "dir reversed, one axis": flipped("dir{}"),
    "dir reversed, all": flipped("dir{}", one=False),
    "joint counted in reverse": flipped("q{}_rad", "dir{}", "tau{}_nm"),
    "q3 holds q3 + q2": WrongStatement(after=coupled),
    "zero convention": WrongStatement(after=quarter_turns),
    "torque in mNm": torque_times(lambda cell: 1000.0),
    "torque in kNm": torque_times(lambda cell: 0.001),
    "torque of the motors": torque_times(motor_side),
    "current as torque": torque_times(amperes),
    "lengths in mm": set_to(length_unit=1000.0),
    "known mass in grams": known(1000.0),
    "known mass": known(1.0, clean=True),
    "known mass x0.7": known(0.7),
    "known mass x0.7, no centre": known(0.7, centre=False),
    "known mass, constants x1.41": known(1.0, constants=2.0**0.5),
    "undeclared sin(2 q2)": WrongStatement(undeclared_wave),
    "one-sided visits": set_to(one_sided=True),
    "joint zeros 0.5 deg": zeros(0.5),
    "joint zeros 1 deg": zeros(1.0),
    "friction 10 % lopsided, loaded": set_to(lopsided=0.10),
    "hose with the load": set_to(hose=0.03),
    "same label, 10 % heavier": WrongStatement(heavier_later, open=True),
    "load changes halfway": WrongStatement(lighter_later, open=True),
    "URDF of a larger size": WrongStatement(other_size, open=True),
    "gravity upside down": set_to(gravity_up=-1.0),
    "one posture": WrongStatement(one_posture),
}
