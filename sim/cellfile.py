"""Reader of cell files and drive profiles for the simulator.

A reader of its own: the simulated drives must not share a formula, nor a mistake, with the master. Only what is needed
is checked here; the gateway is the strict reader of the same files.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.dh import chain_of_rows
from sim.plant import Payload
from sim.urdf import SimChain, UrdfError, read_chain, rotation_rpy

Array = NDArray[np.float64]
Table = Mapping[str, Any]

#: "lockstep": simulated time advances by one period with each SYNC; "real": in real time.
PACINGS = ("lockstep", "real")
PAYLOAD_DENSITY_KG_M3 = 2500.0
#: From the last joint to the centre of gravity of any load [m].
LARGEST_LEVER_M = 5.0
#: Constants of an axis that a cell may leave out.
OPTIONAL_CONSTANTS = ("rotor_inertia_kg_m2", "coulomb_nm", "viscous_nm_s_rad")


class CellFileError(ValueError):
    """A file is not usable for the simulator; the message states the place, the error and the remedy."""


@dataclass(frozen=True, slots=True)
class CellBus:
    """CAN bus in the notation of python-can, with SYNC period and pacing.

    `pacing` is "lockstep" (simulated time advances with each SYNC) or "real" (by the wall clock).
    """

    interface: str
    channel: str
    bitrate_bit_s: int = 1_000_000
    sync_period_s: float = 0.01
    pacing: str = "lockstep"
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class AxisSpec:
    """Axis of the cell file; `profile` is the parsed TOML of its drive profile."""

    node_id: int
    profile: Table
    torque_constant_nm_per_a: float
    gear_ratio: float
    gear_efficiency: float
    position_sign: int
    torque_sign: int
    zero_offset_rad: float
    position_limit_rad: tuple[float, float]
    speed_limit_rad_s: float
    torque_limit_nm: float
    rotor_inertia_kg_m2: float = 0.0
    coulomb_nm: float = 0.0
    viscous_nm_s_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class ArmSpec:
    """Arm of the cell file: kinematic chain, axes and mounting direction.

    `start_rad` is where the arm starts, and one of a pair grips the part; `assumed_links` = masses and shapes are
    assumed. `base` (4, 4) is the base in the world; `flange` and `fingertip` (4, 4) are both in the frame of the last
    link [m].
    """

    name: str
    bus: str
    chain: SimChain
    gravity_m_s2: Array
    coupling: Array
    axes: tuple[AxisSpec, ...]
    start_rad: tuple[float, ...] | None = None
    assumed_links: bool = False
    base: Array = field(default_factory=lambda: np.eye(4))
    flange: Array = field(default_factory=lambda: np.eye(4))
    fingertip: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True, slots=True)
class CellSpec:
    """Content of a cell file; `pair` is the table of two arms that hold one workpiece."""

    name: str
    buses: Mapping[str, CellBus]
    arms: tuple[ArmSpec, ...]
    pair: Table | None = None


def read_toml(path: Path) -> Table:
    """Parse one TOML file.

    Raises
    ------
    CellFileError : the file cannot be read or is not TOML
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise CellFileError(f"{path}: cannot be read: {error}. Give the path of an existing file.") from error
    except tomllib.TOMLDecodeError as error:
        raise CellFileError(f"{path}: not valid TOML: {error}. Correct the file.") from error


def read_cell(path: Path) -> CellSpec:
    """Read a cell file with the robot and the drive profiles it names.

    Raises
    ------
    CellFileError : a file cannot be read, a key is missing or of the wrong kind
    """
    table = read_toml(path)
    try:
        buses = {name: _bus(entry) for name, entry in table["bus"].items()}
        arms = tuple(_arm(entry, path) for entry in table["arm"])
        for arm in arms:
            if arm.bus not in buses:
                raise CellFileError(f"{path}: arm '{arm.name}' names bus '{arm.bus}', which has no [bus.{arm.bus}]")
        return CellSpec(name=str(table["name"]), buses=buses, arms=arms, pair=table.get("pair"))
    except KeyError as error:
        raise CellFileError(f"{path}: key {error} is missing; add it to the file.") from error
    except UrdfError as error:
        raise CellFileError(str(error)) from error
    except (TypeError, ValueError, AttributeError) as error:
        if isinstance(error, CellFileError):
            raise
        raise CellFileError(f"{path}: a value is of the wrong kind: {error}. Correct the file.") from error


def _bus(entry: Table) -> CellBus:
    return CellBus(
        interface=str(entry["interface"]),
        channel=str(entry["channel"]),
        bitrate_bit_s=int(entry.get("bitrate_bit_s", 1_000_000)),
        sync_period_s=float(entry.get("sync_period_s", 0.01)),
        pacing=str(entry.get("pacing", "real")),
        options=dict(entry.get("options", {})),
    )


def parse_bus_spec(text: str, cell_bus: CellBus) -> CellBus:
    """`INTERFACE:CHANNEL[,key=value]...` in place of the interface of a cell's bus; timing stays the cell's.

    Raises
    ------
    CellFileError : not of that form
    """
    head, *pairs = text.split(",")
    interface, colon, channel = head.partition(":")
    if not interface or not colon or not channel or any("=" not in pair for pair in pairs):
        raise CellFileError(
            f"--bus '{text}' is not INTERFACE:CHANNEL[,key=value]..., for example udp_multicast:239.74.163.2,port=43113"
        )
    options = {key: _scalar(value) for key, _, value in (pair.partition("=") for pair in pairs)}
    return CellBus(
        interface,
        channel,
        int(options.pop("bitrate", cell_bus.bitrate_bit_s)),
        cell_bus.sync_period_s,
        cell_bus.pacing,
        options,
    )


def _scalar(text: str) -> str | int | float | bool:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _arm(entry: Table, path: Path) -> ArmSpec:
    name = str(entry["name"])
    axes, chain = len(entry["axis"]), _chain(entry, name, path)
    if axes != len(chain.axis):
        raise CellFileError(
            f"{path}: arm '{name}' has {axes} [[arm.axis]] tables, its robot {len(chain.axis)} joints; give one each."
        )
    flange = pose_of(entry, "flange")
    return ArmSpec(
        name=name,
        bus=str(entry["bus"]),
        chain=chain,
        gravity_m_s2=np.array(entry.get("gravity_m_s2", (0.0, 0.0, -9.80665)), dtype=float),
        coupling=np.array(entry.get("coupling", np.eye(axes)), dtype=float),
        axes=tuple(_axis(axis, path) for axis in entry["axis"]),
        start_rad=tuple(float(value) for value in entry["start_rad"]) if "start_rad" in entry else None,
        assumed_links="robot" not in entry,
        base=pose_of(entry, "base"),
        flange=flange,
        fingertip=flange @ pose_of(entry, "tool"),
    )


def pose_of(entry: Table, name: str) -> Array:
    """Return the pose (4, 4) [m] that `NAME_xyz_m` and `NAME_rpy_rad` of a table state; the identity by default."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_rpy([float(value) for value in entry.get(f"{name}_rpy_rad", (0.0, 0.0, 0.0))])
    pose[:3, 3] = [float(value) for value in entry.get(f"{name}_xyz_m", (0.0, 0.0, 0.0))]
    return pose


def _chain(entry: Table, name: str, path: Path) -> SimChain:
    """Return the kinematic chain from the URDF, or from the Denavit-Hartenberg rows with assumed links."""
    if "robot" not in entry:
        if "dh" not in entry:
            raise CellFileError(f"{path}: arm '{name}' names no robot; give robot = \"FILE.urdf\" or [arm.dh].")
        limits = np.array([axis["torque_limit_nm"] for axis in entry["axis"]], dtype=float)
        return chain_of_rows(entry["dh"], name, entry.get("flange_xyz_m", (0.0, 0.0, 0.0)), limits)
    robot = path.resolve().parent / str(entry["robot"])
    try:
        text = robot.read_bytes()
    except OSError as error:
        raise CellFileError(f"{robot}: cannot be read: {error}. Correct the robot key of {path}.") from error
    return read_chain(text, str(robot), entry.get("tip"))


def _axis(entry: Table, path: Path) -> AxisSpec:
    low, high = entry["position_limit_rad"]
    return AxisSpec(
        node_id=int(entry["node_id"]),
        profile=read_profile(str(entry["profile"]), path.resolve().parent),
        torque_constant_nm_per_a=_constant(entry["torque_constant_nm_per_a"]),
        gear_ratio=_constant(entry["gear_ratio"]),
        gear_efficiency=_constant(entry["gear_efficiency"]),
        position_sign=int(entry.get("position_sign", 1)),
        torque_sign=int(entry.get("torque_sign", 1)),
        zero_offset_rad=float(entry.get("zero_offset_rad", 0.0)),
        position_limit_rad=(float(low), float(high)),
        speed_limit_rad_s=float(entry["speed_limit_rad_s"]),
        torque_limit_nm=float(entry["torque_limit_nm"]),
        **{key: float(entry[key]["value"]) for key in OPTIONAL_CONSTANTS if key in entry},
    )


def _constant(entry: Table) -> float:
    value = float(entry["value"])
    if not math.isfinite(value) or value == 0.0:
        raise CellFileError(f"a constant must be finite and not 0, got {value}")
    return value


def read_profile(name: str, folder: Path) -> Table:
    """Parse a drive profile: by name from the packaged ones, else a TOML file beside the cell, its suffix given or not.

    Raises
    ------
    CellFileError : no such profile, or not TOML
    """
    packaged = resources.files("drives").joinpath("profiles", f"{name}.toml")
    if not name.endswith(".toml") and packaged.is_file():
        return tomllib.loads(packaged.read_text(encoding="utf-8"))
    beside = folder / f"{name}.toml"
    return read_toml(beside if beside.is_file() else folder / name)


def place_of(path: Path, table: str, number: int) -> str:
    """Return file, line of the header and number (from 1) of one table of a list, for messages."""
    lines = path.read_text(encoding="utf-8").splitlines()
    headers = [line for line, text in enumerate(lines, 1) if text.replace(" ", "").startswith(f"[[{table}]]")]
    return f"{path}:{headers[number - 1]}: {table} {number}" if len(headers) >= number else f"{path}: {table} {number}"


def read_payloads(path: Path) -> dict[str, Payload]:
    """Loads of a payload file by label: `[[load]] label, mass_kg, com_m`, `inertia_kg_m2` (3 x 3) if it is known.

    Raises
    ------
    CellFileError : the file cannot be read, a key is missing, a number is not finite or a centre of gravity farther
        than `LARGEST_LEVER_M`, two loads share a label
    """
    loads: dict[str, Payload] = {}
    for number, entry in enumerate(read_toml(path).get("load", []), start=1):
        at = path, "load", number
        try:
            label, mass = str(entry["label"]), float(entry["mass_kg"])
            com = np.array(entry["com_m"], dtype=float)
            inertia = np.array(entry.get("inertia_kg_m2", compact_inertia(mass)), dtype=float)
        except KeyError as error:
            raise CellFileError(f"{place_of(*at)}: key {error} is missing: give label, mass_kg and com_m.") from error
        except (TypeError, ValueError, AttributeError) as error:
            raise CellFileError(f"{place_of(*at)}: a value is of the wrong kind: {error}.") from error
        numbers = np.concatenate([[mass], com.ravel(), inertia.ravel()])
        if com.shape != (3,) or inertia.shape != (3, 3) or mass <= 0 or not np.all(np.isfinite(numbers)):
            raise CellFileError(f"{place_of(*at)}: mass_kg must be positive, com_m three finite numbers.")
        if np.linalg.norm(com) > LARGEST_LEVER_M:
            raise CellFileError(f"{place_of(*at)}: com_m {com.tolist()} is beyond {LARGEST_LEVER_M:g} m: give metres.")
        if label in loads or label == "none":
            raise CellFileError(
                f"{place_of(*at)}: label '{label}' is already used; labels are unique, and `none` is the unloaded arm."
            )
        loads[label] = Payload(label, mass, com, inertia)
    if not loads:
        raise CellFileError(f"{path}: holds no [[load]]; each has label, mass_kg and com_m.")
    return loads


def compact_inertia(mass_kg: float) -> Array:
    """Return the inertia (3, 3) [kg m2] of a solid sphere of 2500 kg/m3, assumed for a load of unknown shape."""
    radius = (max(mass_kg, 1e-9) / (PAYLOAD_DENSITY_KG_M3 * 4.0 / 3.0 * math.pi)) ** (1.0 / 3.0)
    return np.eye(3) * (0.4 * max(mass_kg, 1e-9) * radius**2)
