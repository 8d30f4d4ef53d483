"""Questions for a cell file: each with its format, and where to find the answer."""

from __future__ import annotations

from typing import Final

from drives.draft.questions import Question
from gateway.cell.config import AxisConfig
from gateway.newcell.forms import (
    ANGLES,
    CONSTANTS,
    LENGTHS,
    MASSES,
    PERCENT,
    SPEEDS,
    TIMES,
    TORQUES,
    flag,
    node_ids,
    one_number,
    pairs,
    per_axis,
    place,
    table,
    text,
    words,
)

ROBOT: Final = Question(
    "robot",
    "URDF of the arm, or dh for Denavit-Hartenberg parameters",
    ("in the manufacturer's ROS package (`xacro robot.urdf.xacro > robot.urdf`); DH parameters are in the manual",),
    text,
)
TIP: Final = Question(
    "tip", "last link of the arm in the URDF", ("needed if the file also contains fingers, jaws or a second arm",), text
)
DH_CONVENTION: Final = Question(
    "dh_convention",
    "Denavit-Hartenberg convention: modified (Craig) or standard (Paul)",
    ("modified: alpha and a of a row belong to the link before its joint; standard: to the link after it",),
    text,
)
DH_ROWS: Final = tuple(
    Question(
        f"dh_{column}", f"{what}, base to flange", ("table of link parameters in the manual",), per_axis(for_all=False)
    )
    for column, what in (
        ("alpha_rad", "twists alpha [rad]"),
        ("a_m", "lengths a [m]"),
        ("d_m", "offsets d [m]"),
        ("theta_offset_rad", "angles theta [rad] at q = 0"),
    )
)
BUS: Final = Question(
    "bus",
    "bus of the drives, INTERFACE:CHANNEL[,key=value], such as socketcan:can0 or pcan:PCAN_USBBUS1,bitrate=500000",
    ("name of the adapter in python-can; use the bit rate of the drives",),
    text,
)
NODES: Final = Question(
    "nodes",
    "node ids from the base to the flange, such as 1-6 or 11, 12, 13, 14, 15, 16",
    ("DIP switch or label of each drive; `check --move` detects a wrong order",),
    node_ids,
)
PROFILE: Final = Question(
    "profile",
    "drive profile: a name of `profiles list` or a TOML file, one for all or one per axis",
    ("`servo-gateway profiles list`; for another drive `servo-gateway profiles new --eds FILE -o FILE.toml`",),
    words,
)
GEAR_RATIO: Final = Question(
    "gear_ratio",
    "gear ratio, motor turns per joint turn, such as 160 or 1:160, negative where it turns the sense; one for all or "
    "one per axis",
    ("data sheet or rating plate of the gear; `check --move` compares it with gravity and drive speeds",),
    per_axis(ratio=True),
)
GEAR_EFFICIENCY: Final = Question(
    "gear_efficiency",
    "gear efficiency, such as 0.85 or 85 %; one for all or one per axis",
    ("data sheet of the gear at the torques of the arm",),
    per_axis(PERCENT),
)
TORQUE_CONSTANT: Final = Question(
    "torque_constant_nm_per_a",
    "torque constant of the motor [Nm/A], such as 0.21 or 210 mNm/A, per ampere (rms or "
    "peak) as the profile states; one for all or one per axis",
    ("data sheet of the motor; per peak ampere it is the value per rms ampere divided by 1.414",),
    per_axis(CONSTANTS),
)
POSITION_SIGN: Final = Question(
    "position_sign",
    "sign of drive position relative to the joint, 1 or -1; one for all or one per axis",
    ("`check --move` reports reversed signs",),
    per_axis(),
)
TORQUE_SIGN: Final = Question(
    "torque_sign",
    "sign of drive torque relative to the joint, 1 or -1; one for all or one per axis",
    ("`check --move` reports reversed signs",),
    per_axis(),
)
ZERO_OFFSET: Final = Question(
    "zero_offset_rad",
    "joint angle [rad] at which each drive's position is zero; one for all or one per axis",
    ("calibration sheet of the arm, or the angle on its previous controller when the drive position is zero",),
    per_axis(ANGLES),
)
POSITION_LIMIT: Final = Question(
    "position_limit_rad",
    "lowest and highest joint angle [rad], or such as -170, 170 deg; one pair for all or one per axis, such as "
    "[[-2.9, 2.9], [-1.5, 2.0]]",
    ("working range in the manual, slightly within the hard stops",),
    pairs(ANGLES),
)
SPEED_LIMIT: Final = Question(
    "speed_limit_rad_s",
    "speed limit of each joint [rad/s]; one for all or one per axis",
    ("a low value is sufficient: loads are measured at rest",),
    per_axis(SPEEDS),
)
TORQUE_LIMIT: Final = Question(
    "torque_limit_nm",
    "largest torque at each joint [Nm]; one for all or one per axis",
    ("data sheet of the gear, or rated torque of the motor times gear ratio",),
    per_axis(TORQUES),
)
INERTIALS: Final = Question(
    "inertials",
    "uncertainty of the URDF masses: exact, ignore, or prior:S with relative standard deviation S",
    ("prior:0.05 for the manufacturer's URDF, ignore for masses of unknown source",),
    text,
)
MOUNTING: Final = Question(
    "mounting",
    "how the arm is mounted: floor, ceiling, or gravity in its base frame [m/s2], such as [9.80665, 0, 0] on a wall",
    ("the base frame is that of the robot drawing; z points away from the base plate",),
    place(floor=(0.0, 0.0, -9.80665), ceiling=(0.0, 0.0, 9.80665)),
)
FLANGE: Final = Question(
    "flange_xyz_m",
    "position of the flange in the last link, x, y, z [m], or none",
    ("drawing of the wrist; without it, results are given only in the last link",),
    place(LENGTHS, none=()),
)
FLANGE_TURN: Final = Question(
    "flange_rpy_rad",
    "orientation of the flange in the last link, roll, pitch, yaw [rad], such as 0, 1.5708, 0 or 0, 90, 0 deg",
    ("drawing of the wrist: needed if z of the flange is not along z of the last link",),
    place(ANGLES),
)
RATED_LOAD: Final = Question(
    "rated_load_kg",
    "rated load of the arm [kg], or none",
    ("data sheet or rating plate of the arm; loads above five times this value are refused as unit errors",),
    one_number(MASSES, none=True),
)
MAX_LOAD: Final = Question(
    "max_load_kg",
    "heaviest load to be mounted [kg], or none",
    ("default: the rated load; without both, half of each torque limit is reserved for the load",),
    one_number(MASSES, none=True),
)
MAX_LOAD_COM: Final = Question(
    "max_load_com_m",
    "centre of gravity of that load in the last link, x, y, z [m], such as 0, 0, 250 mm, or none for the flange",
    (
        "drawing of the tool; poses are planned so that the drives hold this load, and the further out, the "
        "fewer remain",
    ),
    place(LENGTHS, none=()),
)
NAME: Final = Question("name", "name of the cell", ("",), text)
SYNC_PERIOD: Final = Question(
    "sync_period_s",
    "SYNC period [s]",
    ("0.01 suits six drives at 1 Mbit/s; `check` computes the bus load",),
    one_number(TIMES),
)
PACING: Final = Question("pacing", "real, or lockstep on the simulator", ("",), text)
OFFLINE: Final = Question("offline", "true: no bus is used", ("",), flag)
EDS: Final = Question(
    "eds", "EDS or DCF files, one per axis or one for all", ("supplied by the drive manufacturer",), words
)
POSES: Final = Question("poses", "the table [poses] of the cell", ("",), table)

#: All keys of an answer file.
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
    MAX_LOAD_COM,
    POSES,
)
DH_KEYS: Final = (DH_CONVENTION.key, *(question.key for question in DH_ROWS))
#: Answers that are file names.
FILES: Final = (ROBOT.key, EDS.key, PROFILE.key)

#: Questions that are not asked at the terminal: a default exists, or an option of the command.
UNASKED: Final = (NAME, TIP, OFFLINE, EDS, SYNC_PERIOD, PACING, MAX_LOAD, POSES)

#: Their keys, in order.
KEYS: Final = tuple(question.key for question in ALL)
#: Keys of an axis in the cell file, in its order: one answer may apply to all axes.
FOR_ALL: Final = tuple(key for key in AxisConfig.model_fields if key in KEYS)
#: Numbers that the cell file has with their source.
SOURCED: Final = tuple(question.key for question in (TORQUE_CONSTANT, GEAR_RATIO, GEAR_EFFICIENCY, RATED_LOAD))
