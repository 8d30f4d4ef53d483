"""Promises of the readers of files: cell, profile, robot, measured table, result."""

from __future__ import annotations

import csv
import io
import json
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from benchmarks.fuzz.guard import bounded
from benchmarks.fuzz.mutate import damaged, edited
from drives.errors import ConfigurationRefused, ProfileError
from drives.ledger import WriteLedger
from drives.profile_file import PROFILE_FOLDER, check_eds, load_profile, parse_profile
from gateway.cell.config import load_cell
from gateway.data.table import read_csv
from gateway.errors import ConfigError, InputError
from gateway.model.robot import robot_from_urdf
from gateway.result.result import from_json, to_json
from sim.fault import Fault
from sim.faults import FaultError, parse_faults

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
WORK = tempfile.TemporaryDirectory(prefix="fuzz-")


def in_file(data: bytes, name: str) -> Path:
    """A file with this content, the same name every time."""
    path = Path(WORK.name) / name
    path.write_bytes(data)
    return path


def seeds(pattern: str) -> list[bytes]:
    """Content of the example files that match."""
    return [path.read_bytes() for path in sorted(EXAMPLES.glob(pattern))]


# --------------------------------------------------------------------------------------------------------- TOML, URDF


def cells() -> st.SearchStrategy[bytes]:
    return damaged(seeds("*/cell.toml"))


def check_cell(data: bytes) -> None:
    """A complete cell with finite limits, or `ConfigError`."""
    path = in_file(data, "cell.toml")
    loaded = bounded(lambda: load_cell(path), (ConfigError,), len(data))
    if loaded is not None:
        assert loaded.text == data.decode().replace("\r\n", "\n").replace("\r", "\n")
        for arm in loaded.cell.arm:
            limits = [[*axis.position_limit_rad, axis.speed_limit_rad_s, axis.torque_limit_nm] for axis in arm.axis]
            assert np.isfinite(limits).all()


def profiles() -> st.SearchStrategy[bytes]:
    return damaged([path.read_bytes() for path in sorted(PROFILE_FOLDER.glob("*.toml"))])


def check_profile(data: bytes) -> None:
    """A profile whose constants are finite, or `ProfileError`."""
    text = data.decode("utf-8", "replace")
    profile = bounded(lambda: parse_profile(text, "profile.toml"), (ProfileError,), len(data))
    if profile is not None:
        assert profile.text == text
        assert parse_profile(profile.text, "again") == profile


def robots() -> st.SearchStrategy[bytes]:
    return damaged(seeds("*/robot.urdf"))


def check_urdf(data: bytes) -> None:
    """Two to eight orthonormal placements and unit axes, no negative mass, or `ConfigError`."""
    text = data.decode("utf-8", "replace")
    robot = bounded(lambda: robot_from_urdf(text, "robot.urdf"), (ConfigError,), len(data))
    if robot is not None:
        assert 1 <= robot.axes <= 8
        turn = robot.placement[:, :3, :3]
        assert np.allclose(turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-9)
        assert np.allclose(np.linalg.norm(robot.axis, axis=1), 1.0)
        assert np.isfinite(robot.placement).all()
        assert not (robot.mass_kg < 0).any()
        assert not np.isinf(robot.mass_kg).any()


# ---------------------------------------------------------------------------------------------------------------- CSV

CSV_SEEDS = [
    b"pose,q1_rad,q2_rad,q3_rad,q4_rad,tau2_nm,dir4\n" + b"".join(b"%d,0.1,0.2,-0.3,0.4,5.5,1\n" % k for k in range(4)),
    b"run,load,pose,"
    + ",".join([*(f"q{i}_rad" for i in range(1, 7)), *(f"tau{i}_nm" for i in range(1, 7))]).encode()
    + b"\n"
    + b"".join(
        f"r,{load},{pose},{','.join(f'{0.1 * pose + 0.3 * i:.3f}' for i in range(12))}\n".encode()
        for load in ("none", "a")
        for pose in range(6)
    ),
    b"time_s,"
    + ",".join(
        f"{name.format(i)}"
        for name in ("q{}_rad", "qd{}_rad_s", "qdd{}_rad_s2", "taum{}_nm", "taum{}_std_nm")
        for i in range(1, 7)
    ).encode()
    + b",n,x_note\n"
    + b"".join(
        f"{0.01 * row:.2f},{','.join(f'{np.sin(row + i):.4f}' for i in range(24))},{'0.1,' * 6}10,{row}\n".encode()
        for row in range(8)
    ),
]


def tables() -> st.SearchStrategy[bytes]:
    return damaged(CSV_SEEDS)


def check_csv(data: bytes) -> None:
    """Every number as it is in the file, row by row, or `InputError` that names the file."""
    path = in_file(data, "table.csv")
    table = bounded(lambda: read_csv(path, None), (InputError,), len(data))
    if table is None:
        return
    assert np.isfinite(table.q_rad).all()
    reader = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""))
    rows = dict((reader.line_num, row) for row in reader if row)  # noqa: C402
    names = [name.strip() for name in rows.pop(min(rows))]
    for line, row in rows.items():
        assert line in table.line or row in [rows[kept] for kept in table.line]
    for axis in range(table.axes):
        column = names.index(f"q{axis + 1}_rad")
        assert [float(rows[line][column]) for line in table.line] == list(table.q_rad[:, axis])


# --------------------------------------------------------------------------------------------------------------- JSON

RESULT_SEED = b"""{"schema": 1, "robot": "kr300", "loads": [{"label": "a", "mass_kg": 21.0, "mass_std_kg": 0.2,
 "com_m": [0.01, 0.0, 0.18], "com_std_m": [0.004, 0.004, 0.006], "frame": "link_6",
 "correlation": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "unidentifiable": [],
 "per_pose_mass_kg": {"1": 21.2}}], "verdict": "explained", "effects": [{"name": "balancer_spring", "joints": [2],
 "parameters": {"stiffness_n_m": 1.0}, "std": {"stiffness_n_m": 0.1}, "evidence": {"holdout_rms_ratio": 0.47,
 "p_value": 1e-9, "runner_up": "link_mass", "odds": 1e4}}], "before": {"rms_nm": [0, 0, 0, 0, 0, 0],
 "holdout_rms_nm": [0, 0, 0, 0, 0, 0], "loads": []}, "after": {"rms_nm": [0, 0, 0, 0, 0, 0],
 "holdout_rms_nm": [0, 0, 0, 0, 0, 0], "loads": []}, "holdout_kind": "fresh", "noise_floor_nm": [0, 0, 0, 0, 0, 0],
 "friction_band_nm": [0, 0, 0, 0, 0, 0], "rejected": [{"name": "base_tilt", "joints": [], "holdout_rms_ratio": 1.0}],
 "next": [{"what": "measure", "poses_rad": [[0, 0, 0, 0, 0, 0]], "tells_apart": ["base_tilt"]}],
 "findings": [{"severity": "fail", "where": "J4", "what": "torque sign is reversed", "advice": "x"}],
 "provenance": {}}"""


def results() -> st.SearchStrategy[bytes]:
    return damaged([RESULT_SEED])


def check_result(data: bytes) -> None:
    """A result that is written and read back the same, or `InputError`."""
    text = data.decode("utf-8", "replace")
    result = bounded(lambda: from_json(text, "result.json"), (InputError,), len(data))
    if result is not None:
        assert to_json(from_json(to_json(result))) == to_json(result)


SCENARIO_SEED = b"""[[fault]]
kind = "emcy"
node = 3
at_sync = 200
code = 0x3210

[[fault]]
kind = "tpdo_random_loss"
share = 0.01
syncs = 0
seed = 7
"""


def scenarios() -> st.SearchStrategy[bytes]:
    return damaged([SCENARIO_SEED])


def check_scenario(data: bytes) -> None:
    """Faults of known kinds, or `FaultError`."""
    text = data.decode("utf-8", "replace")
    faults = bounded(lambda: parse_faults(text), (FaultError,), len(data))
    assert faults is None or all(isinstance(fault, Fault) and 0 <= fault.share <= 1 for fault in faults)


# -------------------------------------------------------------------------------------------------------- ledger, EDS

LEDGER_SEED = json.dumps(
    {
        "schema": 1,
        "entries": [
            {
                "node_id": node,
                "index": 0x1016,
                "subindex": 1,
                "data_type": "u32",
                "old": 0,
                "new": 0x7F01F4,
                "reason": "the drive stops when the master is gone",
                "serial_number": 5308416 + node,
            }
            for node in range(1, 4)
        ],
    }
).encode()


def ledgers() -> st.SearchStrategy[bytes]:
    return damaged([LEDGER_SEED])


def check_ledger(data: bytes) -> None:
    """Entries that can be written back, or `ConfigurationRefused`."""
    path = in_file(data, "ledger.json")
    ledger = bounded(lambda: WriteLedger(path), (ConfigurationRefused,), len(data))
    if ledger is not None:
        for entry in ledger.entries:
            assert str(entry)
            assert all(isinstance(value, int) for value in (entry.node_id, entry.index, entry.old))


SHEET_SEED = b"""[FileInfo]
FileName=drive.eds
EDSVersion=4.0

[DeviceInfo]
VendorName=a make
BaudRate_1000=1

[MandatoryObjects]
SupportedObjects=1
1=0x1000

[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x20192
PDOMapping=0

[OptionalObjects]
SupportedObjects=2
1=0x1018
2=0x6077

[1018]
ParameterName=Identity object
ObjectType=0x9
SubNumber=2

[1018sub0]
ParameterName=number of entries
ObjectType=0x7
DataType=0x0005
AccessType=ro

[1018sub1]
ParameterName=Vendor ID
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=$NODEID+0x9A

[6077]
ParameterName=Torque actual value
ObjectType=0x7
DataType=0x0003
AccessType=ro
PDOMapping=1
LowLimit=-32768
HighLimit=32767
"""


def sheets() -> st.SearchStrategy[bytes]:
    return edited([SHEET_SEED])


def check_sheet(data: bytes) -> None:
    """A data sheet that fits the profile, or `ProfileError`."""
    path = in_file(data, "drive.eds")
    profile = load_profile("generic-cia402")
    bounded(lambda: check_eds(profile, path), (ProfileError,), len(data))
