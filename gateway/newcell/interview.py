"""Sequence of the interview: arm, bus, drives, gears, limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from drives.bus_spec import BusSpec
from drives.profile import DriveProfile
from drives.profile_file import contradictions, find_profile
from gateway.cell.config import DhTable
from gateway.errors import ConfigError
from gateway.model.load_bounds import bounds_of
from gateway.model.placeholders import model_remarks
from gateway.model.robot import Robot, robot_from_dh, robot_from_urdf
from gateway.model.urdf_text import read_urdf
from gateway.newcell import offers, questions
from gateway.newcell.answers import ASSUMED, DH, Answer, CellAnswers
from gateway.newcell.nodes import BusEyes, SeenNode, addresses, of_axes
from gateway.newcell.offers import Axes

DEFAULT_BUS = "socketcan:can0"
#: Number of data sheet remarks printed.
REMARKS_SHOWN = 10


@dataclass(frozen=True, slots=True)
class Draft:
    """Content of a cell file before it is written as text.

    Attributes
    ----------
    answers : CellAnswers
    robot : Robot
    urdf : str or None
        Path of the URDF; None = Denavit-Hartenberg rows.
    bus : BusSpec
    nodes : list of SeenNode or None
        Device of each axis; None = not seen.
    profiles : tuple of DriveProfile
    remarks : tuple of str
        Inconsistencies.
    looked : bool
        Whether the bus was read.
    """

    answers: CellAnswers
    robot: Robot
    urdf: str | None
    bus: BusSpec
    nodes: list[SeenNode | None]
    profiles: tuple[DriveProfile, ...]
    remarks: tuple[str, ...]
    looked: bool


def interview(answers: CellAnswers, eyes: BusEyes, name: str, report: Callable[[str], None]) -> Draft:
    """Determine all values of a cell file.

    Parameters
    ----------
    answers : CellAnswers
    eyes : BusEyes
    name : str
        Default name of the cell.
    report : callable
        Called with each result.

    Raises
    ------
    ConfigError
        An answer of the wrong form or a missing one, a robot or profile that cannot be used.
    DriveError
        Bus or drive.
    """
    last = Answer("", "last link moved by a joint")
    answers.settle([(questions.NAME, Answer(name, "name of the file")), (questions.ROBOT, None), (questions.TIP, last)])
    robot, urdf = _robot(answers, name)
    report(f"{robot.name}: {robot.axes} axes: {', '.join(robot.joint_names)}")
    for remark in model_remarks(robot):
        report(remark)
    answers.settle(
        [
            (questions.OFFLINE, Answer(False, "the bus is read")),
            (questions.EDS, Answer((), "none given")),
            (questions.BUS, Answer(DEFAULT_BUS, f"{ASSUMED}: first adapter")),
            (questions.SYNC_PERIOD, Answer(0.01, "six drives at 1 Mbit/s")),
            (questions.PACING, Answer("real", "real time")),
            (questions.POSES, Answer({}, "as in the cell file")),
        ]
    )
    spec = BusSpec.parse(answers.value(questions.BUS))
    looked = not answers.value(questions.OFFLINE)
    on_bus = eyes.nodes(spec) if looked else ()
    in_files = eyes.files([Path(path) for path in answers.value(questions.EDS)])
    for node in (*on_bus, *in_files):
        report(f"{node.name}: {_who(node)}")
        remarks = () if node.sheet is None else node.sheet.remarks
        lines = [f"{node.name} {remark}" for remark in remarks[:REMARKS_SHOWN]]
        more = len(remarks) - len(lines)
        for line in [*lines, f"{node.name}: {more} more lines are not used as written"] if more else lines:
            report(line)
    axes, nodes = _drives(answers, robot, eyes if looked else None, (spec, on_bus, in_files))
    _gears(answers, axes)
    axes = Axes(axes.nodes, axes.profiles, answers.value(questions.GEAR_RATIO))
    _limits(answers, robot, axes)
    reported = {profile.name: profile.obstacles for profile in axes.profiles}
    # `check` refuses drives with an internal gear ratio
    geared: list[str] = []
    for each in nodes:
        motor = None if each is None else each.read("gear_motor_revolutions")
        shaft = None if each is None else each.read("gear_shaft_revolutions")
        if each is not None and motor is not None and shaft is not None and motor.value != shaft.value:
            geared.append(f"{each.name}: 0x6091 is {motor.value}:{shaft.value}; set it to 1:1, the cell has the ratio")
    remarks = (
        *_strangers(on_bus, in_files, answers.value(questions.NODES)),
        *geared,
        *[f"profile {name} refuses motion: {obstacle}" for name, found in reported.items() for obstacle in found],
        *_contradicted(nodes, axes.profiles),
    )
    return Draft(answers, robot, urdf, spec, nodes, tuple(axes.profiles), remarks, looked)


def _who(node: SeenNode) -> str:
    who = node.identity
    numbers = ", ".join(
        f"{what} 0x{value:X}"
        for what, value in (("vendor", who.vendor_id), ("product", who.product_code), ("serial", who.serial_number))
        if value is not None
    )
    fits = ", ".join(node.profiles) or "none"
    return f"{who.name or 'drive'} ({numbers}); matching profiles: {fits}"


def _robot(answers: CellAnswers, name: str) -> tuple[Robot, str | None]:
    """Return the robot model and the path of its URDF."""
    said = answers.value(questions.ROBOT)
    if said == DH:
        answers.settle([(question, None) for question in (questions.DH_CONVENTION, *questions.DH_ROWS)])
        return robot_from_dh(dh_table(answers), name), None
    path = Path(said)
    try:
        text = read_urdf(path)
    except ConfigError as error:
        error.add_note("or enter dh for Denavit-Hartenberg parameters")
        raise
    return robot_from_urdf(text, str(path), answers.value(questions.TIP) or None), str(path.resolve())


def dh_table(answers: CellAnswers) -> DhTable:
    """Return the Denavit-Hartenberg parameters; columns of different length are refused.

    Raises
    ------
    ConfigError
    """
    columns = {question.key.removeprefix("dh_"): answers.value(question) for question in questions.DH_ROWS}
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1:
        counts = ", ".join(f"dh_{key} {len(column)}" for key, column in columns.items())
        raise ConfigError(
            f"Denavit-Hartenberg columns of different length ({counts}): give one number per axis in each"
        )
    return DhTable.model_validate({"convention": answers.value(questions.DH_CONVENTION), **columns})


def _drives(
    answers: CellAnswers,
    robot: Robot,
    eyes: BusEyes | None,
    seen: tuple[BusSpec, Sequence[SeenNode], Sequence[SeenNode]],
) -> tuple[Axes, list[SeenNode | None]]:
    """Determine node ids, profiles and device data."""
    spec, on_bus, in_files = seen
    order = offers.stored_order(in_files, robot.axes) or offers.node_order(on_bus, robot.axes)
    answers.settle([(questions.NODES, order)], robot.axes)
    ids: tuple[int, ...] = answers.value(questions.NODES)
    twice = sorted({node for node in ids if ids.count(node) > 1})
    if twice:
        raise ConfigError(f"nodes: node id {twice[0]} is used for more than one axis; each drive needs its own node id")
    nodes = of_axes(ids, on_bus, in_files)
    answers.settle([(questions.PROFILE, offers.profile_names(nodes))], robot.axes)
    profiles = [find_profile(name, Path()) for name in answers.value(questions.PROFILE)]
    if eyes is not None:
        present = {node.node_id for node in on_bus}
        wanted = {node_id: addresses([profiles[axis]]) for axis, node_id in enumerate(ids) if node_id in present}
        values = eyes.values(spec, wanted)
        live = [replace(node, values=values.get(node.node_id or 0, {})) for node in on_bus]
        nodes = of_axes(ids, live, in_files)
    return Axes(nodes, profiles), nodes


def _gears(answers: CellAnswers, axes: Axes) -> None:
    """Determine the constants between motor and joint."""
    count = len(axes.profiles)
    constant = offers.torque_constant(axes)
    if constant is None and not any(profile.needs_torque_constant for profile in axes.profiles):
        constant = offers.everywhere(1.0, count, "not used: the drives report torque")
    answers.settle(
        [
            (questions.GEAR_RATIO, offers.gear_ratio(axes)),
            (questions.GEAR_EFFICIENCY, offers.everywhere(offers.GEAR_EFFICIENCY, count, "typical robot gear")),
            (questions.TORQUE_CONSTANT, constant),
            (questions.POSITION_SIGN, offers.everywhere(1, count, "drive and joint have the same direction")),
            (questions.TORQUE_SIGN, offers.everywhere(1, count, "drive and joint have the same direction")),
            (questions.ZERO_OFFSET, offers.everywhere(0.0, count, "zero of the drives equals zero of the robot")),
        ],
        count,
    )


def _limits(answers: CellAnswers, robot: Robot, axes: Axes) -> None:
    """Determine limits, mounting and load."""
    sign, zero_rad = answers.value(questions.POSITION_SIGN), answers.value(questions.ZERO_OFFSET)
    answers.settle(
        [
            (questions.POSITION_LIMIT, offers.position_limits(robot, axes, sign, zero_rad)),
            (questions.SPEED_LIMIT, offers.speed_limits(robot, axes)),
            (questions.TORQUE_LIMIT, offers.torque_limits(robot, axes)),
            (questions.INERTIALS, offers.inertials(robot)),
            (questions.MOUNTING, Answer((0.0, 0.0, -9.80665), f"{ASSUMED}: mounted on the floor")),
        ],
        robot.axes,
    )
    place, turn = offers.flange_frame(robot) or (
        Answer((), f"{ASSUMED}: results only in the last link"),
        Answer((0.0, 0.0, 0.0), f"{ASSUMED}: not rotated in the last link"),
    )
    answers.settle([(questions.FLANGE, place)])
    if not answers.value(questions.FLANGE):
        turn = Answer((0.0, 0.0, 0.0), "no flange")
    elif answers.taken[questions.FLANGE.key] is not place:
        turn = replace(turn, source=f"{ASSUMED}: not rotated in the last link", value=(0.0, 0.0, 0.0))
    answers.settle([(questions.FLANGE_TURN, turn)])
    torque: Sequence[float] = answers.value(questions.TORQUE_LIMIT)
    torque_nm = None if answers.taken[questions.TORQUE_LIMIT.key].guessed else max(torque)
    trusted = answers.value(questions.INERTIALS) != "ignore"
    answers.bounds = bounds_of(robot, torque_nm, trusts_masses=trusted)
    answers.settle(
        [(questions.RATED_LOAD, Answer(None, f"{ASSUMED}: half of each torque limit is reserved for loads"))]
    )
    rated = answers.value(questions.RATED_LOAD)
    offer = Answer(rated, "half of each torque limit is reserved for it" if rated is None else "the rated load")
    if rated is not None:
        answers.bounds = bounds_of(robot, torque_nm, (rated, questions.RATED_LOAD.key), trusts_masses=trusted)
    answers.settle([(questions.MAX_LOAD, offer)])
    if answers.value(questions.MAX_LOAD) is not None:
        answers.settle([(questions.MAX_LOAD_COM, Answer((), f"{ASSUMED}: at the origin of the flange"))])


def _strangers(on_bus: Sequence[SeenNode], in_files: Sequence[SeenNode], ids: Sequence[int]) -> list[str]:
    """Report missing and unexpected nodes, and files of another device."""
    remarks: list[str] = []
    if on_bus:
        there = {node.node_id for node in on_bus}
        remarks += [f"node {node}: no answer; check supply, node id and cabling" for node in ids if node not in there]
        remarks += [
            f"{node.name}: on the bus, but not an axis of this arm" for node in on_bus if node.node_id not in ids
        ]
    for node, sheet in zip(of_axes(ids, on_bus, ()), of_axes(ids, (), in_files), strict=True):
        if node is None or sheet is None:
            continue
        for what in ("vendor_id", "product_code"):
            live, stated = getattr(node.identity, what), getattr(sheet.identity, what)
            if None not in (live, stated) and live != stated:
                words = what.replace("_", " ")
                remarks.append(
                    f"{sheet.name} belongs to another device: {words} 0x{stated:X}, {node.name} has 0x{live:X}"
                )
    return remarks


def _contradicted(nodes: Sequence[SeenNode | None], profiles: Sequence[DriveProfile]) -> list[str]:
    """Report profiles that use objects missing in the data sheet of their drive, once per pair."""
    reported: dict[tuple[str, str], str] = {}
    for node, profile in zip(nodes, profiles, strict=True):
        if node is not None and node.sheet is not None:
            problems = contradictions(profile, node.sheet)
            if problems:
                what = f"profile {profile.name} and {node.sheet.name} contradict each other: {'; '.join(problems)}"
                reported[profile.name, node.sheet.name] = what
    return list(reported.values())
