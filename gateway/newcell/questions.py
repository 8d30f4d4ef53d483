"""What a cell file needs and nobody can read: each question with its form, and how an engineer finds the answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gateway.newcell.forms import (
    ANGLES,
    ANY,
    CONSTANTS,
    LENGTHS,
    MASSES,
    NOT_ZERO,
    PERCENT,
    POSITIVE,
    SHARE,
    SIGN,
    SPEEDS,
    TIMES,
    TORQUES,
    Form,
    choice,
    flag,
    node_ids,
    number_or_none,
    numbers,
    one_number,
    pairs,
    pattern,
    per_axis,
    place,
    table,
    text,
    words,
)


@dataclass(frozen=True, slots=True)
class CellQuestion:
    """One thing to be known.

    Attributes
    ----------
    key : str
        In answer files.
    asks : str
        What is asked.
    how : str
        Where the answer stands, or how it is found out.
    form : Form
        What an answer looks like.
    """

    key: str
    asks: str
    how: str
    form: Form


ROBOT: Final = CellQuestion(
    "robot",
    "URDF of the arm, or dh for Denavit-Hartenberg rows",
    "the maker's ROS package has a URDF (`xacro robot.urdf.xacro > robot.urdf`); the rows stand in the manual",
    text(),
)
TIP: Final = CellQuestion(
    "tip", "last link of the arm in the URDF", "where fingers, jaws or a second arm are in the file too", text()
)
DH_CONVENTION: Final = CellQuestion(
    "dh_convention",
    "convention of the rows: modified (Craig) or standard (Paul)",
    "modified where alpha and a of a row belong to the link before its joint, standard where to the one behind it",
    choice("modified", "standard"),
)
DH_ROWS: Final = tuple(
    CellQuestion(f"dh_{column}", f"{what}, base to flange", "the table of link parameters in the manual", numbers())
    for column, what in (
        ("alpha_rad", "twists alpha [rad]"),
        ("a_m", "lengths a [m]"),
        ("d_m", "offsets d [m]"),
        ("theta_offset_rad", "angles theta [rad] at q = 0"),
    )
)
BUS: Final = CellQuestion(
    "bus",
    "bus of the drives, INTERFACE:CHANNEL[,key=value], such as socketcan:can0 or pcan:PCAN_USBBUS1,bitrate=500000",
    "python-can's name of the adapter; the bit rate is set in the drives",
    text(),
)
NODES: Final = CellQuestion(
    "nodes",
    "node ids from the base to the flange, such as 1-6 or 11, 12, 13, 14, 15, 16",
    "DIP switch or label of each drive; `check --move` sees an order that is wrong",
    node_ids(),
)
PROFILE: Final = CellQuestion(
    "profile",
    "drive profile: a name of `profiles list` or a TOML file, one for all or one per axis",
    "`servo-gateway profiles list`; for a drive that is not there `servo-gateway profiles new --eds FILE -o FILE.toml`",
    words(),
)
GEAR_RATIO: Final = CellQuestion(
    "gear_ratio",
    "gear ratio, motor turns per joint turn, such as 160 or 1:160, negative where it turns the sense; one for all or "
    "one per axis",
    "data sheet or plate of the gear; `check --move` compares it with gravity and the drives' speeds",
    per_axis(NOT_ZERO.of({}, ratio=True)),
)
GEAR_EFFICIENCY: Final = CellQuestion(
    "gear_efficiency",
    "gear efficiency, such as 0.85 or 85 %; one for all or one per axis",
    "data sheet of the gear at the torques of the arm",
    per_axis(SHARE.of(PERCENT)),
)
TORQUE_CONSTANT: Final = CellQuestion(
    "torque_constant_nm_per_a",
    "torque constant of the motor [Nm/A], such as 0.21 or 210 mNm/A, per ampere (rms or "
    "peak) as the profile states; one for all or one per axis",
    "data sheet of the motor; for peak amperes it is the rms value over 1.414",
    per_axis(POSITIVE.of(CONSTANTS)),
)
POSITION_SIGN: Final = CellQuestion(
    "position_sign",
    "sign of the drives' position against the joint, 1 or -1; one for all or one per axis",
    "`check --move` says which are turned round",
    per_axis(SIGN),
)
TORQUE_SIGN: Final = CellQuestion(
    "torque_sign",
    "sign of the drives' torque against the joint, 1 or -1; one for all or one per axis",
    "`check --move` says which are turned round",
    per_axis(SIGN),
)
ZERO_OFFSET: Final = CellQuestion(
    "zero_offset_rad",
    "joint angle [rad] at which each drive's position is zero; one for all or one per axis",
    "the calibration sheet of the arm, or the angle shown by its old controller while the drives show zero",
    per_axis(ANY.of(ANGLES)),
)
POSITION_LIMIT: Final = CellQuestion(
    "position_limit_rad",
    "lowest and highest joint angle [rad], or such as -170, 170 deg; one pair for all or one per axis, such as "
    "[[-2.9, 2.9], [-1.5, 2.0]]",
    "the manual's working range, a little inside the hard stops",
    pairs(ANY.of(ANGLES)),
)
SPEED_LIMIT: Final = CellQuestion(
    "speed_limit_rad_s",
    "fastest that each joint may turn [rad/s]; one for all or one per axis",
    "slow is enough: a load is measured at rest",
    per_axis(POSITIVE.of(SPEEDS)),
)
TORQUE_LIMIT: Final = CellQuestion(
    "torque_limit_nm",
    "largest torque at each joint [Nm]; one for all or one per axis",
    "data sheet of the gear, or rated torque of the motor times gear ratio",
    per_axis(POSITIVE.of(TORQUES)),
)
INERTIALS: Final = CellQuestion(
    "inertials",
    "trust of the URDF's masses: exact, ignore, or prior:S with S their relative deviation",
    "prior:0.05 for a maker's own URDF, ignore for masses of unknown origin",
    pattern(r"exact|ignore|prior:\d*\.?\d+", "none of exact, ignore, prior:S such as prior:0.1"),
)
MOUNTING: Final = CellQuestion(
    "mounting",
    "how the arm is mounted: floor, ceiling, or gravity in its base frame [m/s2], such as [9.80665, 0, 0] on a wall",
    "the base frame is that of the robot's drawing; z points away from the base plate",
    place(floor=(0.0, 0.0, -9.80665), ceiling=(0.0, 0.0, 9.80665)),
)
FLANGE: Final = CellQuestion(
    "flange_xyz_m",
    "flange in the last link, x, y, z [m], or none",
    "the drawing of the wrist; without it results are in the last link alone",
    place(ANY.of(LENGTHS), none=()),
)
FLANGE_TURN: Final = CellQuestion(
    "flange_rpy_rad",
    "turn of the flange in the last link, roll, pitch, yaw [rad], such as 0, 1.5708, 0 or 0, 90, 0 deg",
    "the drawing of the wrist: where z of the flange points along another axis of the last link, it is turned",
    place(ANY.of(ANGLES)),
)
RATED_LOAD: Final = CellQuestion(
    "rated_load_kg",
    "load that the arm is rated for [kg], or none",
    "data sheet or plate of the arm; loads beyond five times as much are refused as slips of units",
    number_or_none(POSITIVE.of(MASSES)),
)
MAX_LOAD: Final = CellQuestion(
    "max_load_kg",
    "heaviest load that will hang on the flange [kg], or none",
    "the rated load if not stated; without either half of each torque limit is kept for the load",
    number_or_none(POSITIVE.of(MASSES)),
)
NAME: Final = CellQuestion("name", "name of the cell", "", text())
SYNC_PERIOD: Final = CellQuestion(
    "sync_period_s",
    "time from SYNC to SYNC [s]",
    "0.01 suits six drives at 1 Mbit/s; `check` reckons the load of the bus",
    one_number(POSITIVE.of(TIMES)),
)
PACING: Final = CellQuestion("pacing", "real, or lockstep on the simulator", "", choice("real", "lockstep"))
OFFLINE: Final = CellQuestion("offline", "true: no bus is looked at", "", flag())
EDS: Final = CellQuestion(
    "eds", "EDS or DCF files, one per axis or one for all", "the maker of the drive delivers it", words()
)
POSES: Final = CellQuestion("poses", "the table [poses] of the cell", "", table())

#: Every key that an answer file may hold.
ALL: Final = (
    NAME,
    ROBOT,
    TIP,
    DH_CONVENTION,
    *DH_ROWS,
    BUS,
    OFFLINE,
    EDS,
    SYNC_PERIOD,
    PACING,
    NODES,
    PROFILE,
    GEAR_RATIO,
    GEAR_EFFICIENCY,
    TORQUE_CONSTANT,
    POSITION_SIGN,
    TORQUE_SIGN,
    ZERO_OFFSET,
    POSITION_LIMIT,
    SPEED_LIMIT,
    TORQUE_LIMIT,
    INERTIALS,
    MOUNTING,
    FLANGE,
    FLANGE_TURN,
    RATED_LOAD,
    MAX_LOAD,
    POSES,
)
#: Answers that may be one for all axes.
FOR_ALL: Final = tuple(
    question.key
    for question in (
        PROFILE,
        GEAR_RATIO,
        GEAR_EFFICIENCY,
        TORQUE_CONSTANT,
        POSITION_SIGN,
        TORQUE_SIGN,
        ZERO_OFFSET,
        POSITION_LIMIT,
        SPEED_LIMIT,
        TORQUE_LIMIT,
    )
)
DH_KEYS: Final = (DH_CONVENTION.key, *(question.key for question in DH_ROWS))
#: Answers that are names of files.
FILES: Final = (ROBOT.key, EDS.key, PROFILE.key)

#: Questions that a person is not asked: an offer that holds without one, or an option of the command.
UNASKED: Final = (NAME, TIP, OFFLINE, EDS, SYNC_PERIOD, PACING, MAX_LOAD, POSES)

#: Their keys, in order.
KEYS: Final = tuple(question.key for question in ALL)
