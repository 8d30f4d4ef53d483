"""A stranger's arm: from its URDF and its drives' data sheets to a load, by commands and answers alone.

The drives count in units of their own (rated current in 10 mA, peak ampere, 0.1 rpm, 16 bit), have ids 11 to 16 and
no profile in the package. Two axes turn against their joints. The gateway is given what an engineer can read
from data sheets.
"""

from __future__ import annotations

import json
import math
import shutil
import tomllib
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from gateway.cell.config import load_cell
from sim.cellfile import read_payloads
from sim.serve import RunningSimulation, running
from tests.cells import FOLDER as CELLS
from tests.data.sheets import write_sheet
from tests.support.rigs.pacing import measured_shortly
from tests.system.conftest import command

OWN = Path(__file__).parents[2] / "examples" / "own"
MOST_COMMANDS, MOST_ANSWERS = 8, 40
#: Few poses, taken fast: this tests the procedure, not the accuracy.
POSES = "poses = { count = 3, validation = 0, samples = 10, approach_speed_rad_s = 0.2 }\nsync_period_s = 0.04\n"
LOCKSTEP = ("--pacing", "lockstep")


@dataclass
class Newcomer:
    """Types commands in a folder of her own, and counts what she types."""

    folder: Path
    drives: RunningSimulation
    commands: int = 0
    answers: int = 0
    said: list[str] = field(default_factory=list)

    def types(self, *words: object) -> str:
        """A command that has to work; answers of an answer file count."""
        self.commands += 1
        for option, name in zip(words, words[1:], strict=False):
            if option == "--answers":
                self.answers += len(tomllib.loads(Path(str(name)).read_text(encoding="utf-8")))
            if option in ("--answer", "--robot", "--bus"):
                self.answers += 1
        done = command(*words)
        assert done.exit_code == 0, done.output
        self.said.append(done.output)
        return done.output

    @property
    def cell(self) -> Path:
        return self.folder / "cell.toml"

    def writes(self, name: str, text: str) -> Path:
        """An answer file."""
        (self.folder / name).write_text(text, encoding="utf-8")
        return self.folder / name

    def counts(self, load: dict[str, object]) -> None:
        """Few commands and few answers, and no file edited by hand: they are all written above."""
        found = f"{load['mass_kg']:.3f} +- {1.96 * load['mass_std_kg']:.3f} kg"
        print(f"{self.commands} commands, {self.answers} answers, load {found} (95 %)")
        assert self.commands <= MOST_COMMANDS
        assert self.answers <= MOST_ANSWERS

    def measures(self) -> dict[str, object]:
        """From the check to the load: bare, then loaded."""
        bare, loaded, result = (self.folder / name for name in ("bare.h5", "loaded.h5", "result.json"))
        self.types("record", self.cell, *LOCKSTEP, "--yes", "--load", "none", "-o", bare)
        self.drives.mount("load")
        self.types("record", self.cell, *LOCKSTEP, "--yes", "--load", "load", "-o", loaded)
        self.types("estimate", bare, loaded, "--cell", self.cell, "--json", result)
        (load,) = json.loads(result.read_text(encoding="utf-8"))["loads"]
        return load


@pytest.fixture
def newcomer(tmp_path) -> Iterator[Callable[[Path, Path], Newcomer]]:
    with ExitStack() as stack:

        def start(bench: Path, payload: Path) -> Newcomer:
            bus, copied = f"virtual:{uuid.uuid4().hex}", tmp_path / "bench"
            shutil.copytree(bench.parents[1], copied)
            cell = copied / bench.relative_to(bench.parents[1])
            cell.write_text(measured_shortly(bench.read_text(encoding="utf-8")), encoding="utf-8")
            drives = stack.enter_context(running(cell, bus, payload=payload, pacing="lockstep"))
            return Newcomer(tmp_path, drives)

        yield start


def inside(load, payload):
    """The load is inside its 95 % interval, the centre of gravity inside that of three numbers at once."""
    (true,) = read_payloads(payload).values()
    assert abs(load["mass_kg"] - true.mass_kg) < 1.96 * load["mass_std_kg"], load
    assert load["mass_std_kg"] < 0.1 * true.mass_kg
    # Bonferroni: 3 x 1.67 %
    assert (np.abs(load["com_m"] - true.com_m) < 2.39 * np.array(load["com_std_m"])).all(), load


def known(name: str) -> str:
    return (OWN / name).read_text(encoding="utf-8")


def answers(text: str, *without: str) -> str:
    """Lines of an answer file but for some keys, with poses of this test."""
    dropped = (*without, "poses")
    return "\n".join(line for line in text.splitlines() if line.split(" =")[0] not in dropped) + "\n" + POSES


def test_a_dcf_for_each_node_gives_the_cell_without_a_bus(newcomer, tmp_path):
    her = newcomer(OWN / "bench" / "cell.toml", OWN / "bench" / "payload.toml")
    (arm,) = her.drives.simulation.arms
    sheets = [write_sheet(drive, tmp_path / f"n{drive.node_id}.dcf") for drive in arm.drives]
    for name in ("arm.urdf", "bench/drive.toml"):
        shutil.copy(OWN / name, tmp_path / Path(name).name)
    arm_answers = her.writes("answers.toml", answers(known("answers.toml"), "nodes", "profile"))
    more = ("--answers", arm_answers, "--bus", her.drives.bus, "--answer", "profile=drive.toml")
    files = [word for sheet in sheets for word in ("--eds", sheet)]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        her.types("cell", "new", "--offline", *files, *more, "-o", her.cell)
        her.types("cell", "new", *more, "-o", tmp_path / "seen.toml", "--answer", "nodes=11,12,13,14,15,16")
    stored, seen = (load_cell(path).cell.arm[0] for path in (her.cell, tmp_path / "seen.toml"))
    assert [axis.node_id for axis in stored.axis] == [11, 12, 13, 14, 15, 16]
    assert stored == seen
    her.types("check", her.cell, *LOCKSTEP)


#: Rows of an arm like those of the tests before, and what its maker's manual says.
ROWS = """robot = "dh"
dh_convention = "standard"
dh_alpha_rad = [1.5707963, 0, 1.5707963, -1.5707963, 1.5707963, 0]
dh_a_m = [0.03, 0.4, 0.04, 0, 0, 0]
dh_d_m = [0.3, 0, 0, 0.42, 0, 0.08]
dh_theta_offset_rad = [0, 1.5707963, 0, 0, 0, 0]
position_limit_rad = [[-2.8, 2.8], [-1.5, 1.8], [-1.3, 1.8], [-3.1, 3.1], [-1.9, 1.9], [-5.6, 5.6]]
torque_limit_nm = [140, 140, 75, 26, 22, 14]
"""


def rows_on_the_bench(folder: Path) -> Path:
    """The simulated drives with an arm of rows instead of the URDF."""
    table = tomllib.loads(ROWS)
    keys = ("alpha_rad", "a_m", "d_m", "theta_offset_rad")
    rows = "\n".join(f"{key} = {table[f'dh_{key}']}" for key in keys)
    text = known("bench/cell.toml").replace('robot = "../arm.urdf"\n', f'[arm.dh]\nconvention = "standard"\n{rows}\n')
    folder.mkdir(parents=True)
    shutil.copy(OWN / "bench" / "drive.toml", folder / "drive.toml")
    (folder / "bench.toml").write_text(text, encoding="utf-8")
    return folder / "bench.toml"


@pytest.mark.slow
def test_from_rows_without_a_data_sheet_to_the_load(newcomer, tmp_path):
    her = newcomer(rows_on_the_bench(tmp_path / "maker" / "bench"), OWN / "bench" / "payload.toml")
    shutil.copy(OWN / "bench" / "drive.toml", tmp_path / "drive.toml")
    text = answers(known("answers.toml"), "robot", "profile", "flange_xyz_m") + ROWS + 'profile = "drive.toml"\n'
    her.types("cell", "new", "--bus", her.drives.bus, "--answers", her.writes("answers.toml", text), "-o", her.cell)
    her.types("check", her.cell, *LOCKSTEP)
    load = her.measures()
    inside(load, OWN / "bench" / "payload.toml")
    her.counts(load)


@pytest.mark.slow
def test_four_axes(newcomer, tmp_path):
    place = CELLS / "four"
    her = newcomer(place / "cell.toml", place / "payload.toml")
    shutil.copy(place / "robot.urdf", tmp_path / "robot.urdf")
    text = (
        'robot = "robot.urdf"\nprofile = "generic-cia402"\ngear_ratio = [150, 160, 140, 80]\ngear_efficiency = 0.85\n'
        "position_sign = [1, -1, 1, 1]\ntorque_sign = [1, -1, 1, -1]\nzero_offset_rad = [0, 0.02, -0.03, 0.01]\n"
        "speed_limit_rad_s = 0.8\nmax_load_kg = 20\n"
    )
    path = her.writes("answers.toml", text + POSES)
    her.types("cell", "new", "--bus", her.drives.bus, "--answers", path, "-o", her.cell)
    (arm,) = load_cell(her.cell).cell.arm
    assert len(arm.axis) == 4
    # read from the drives: rated torque over rated current, 0.6 Nm/A rounded to mNm and mA; a guess all the same
    constant = arm.axis[0].torque_constant_nm_per_a
    assert math.isclose(constant.value, 0.6, rel_tol=1e-2)
    assert constant.source.startswith("assumed")
    load = her.measures()
    inside(load, place / "payload.toml")
    her.counts(load)


#: A gripper behind the hand as makers' files have it, and a flange that is turned against the last link.
FINGERS = """
<link name="palm"/><joint name="hand_to_palm" type="fixed"><parent link="hand_link"/><child link="palm"/></joint>
<link name="left"/><joint name="left_joint" type="revolute"><parent link="palm"/><child link="left"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.5" effort="20" velocity="0.1"/></joint>
<link name="right"/><joint name="right_joint" type="revolute"><parent link="palm"/><child link="right"/>
<axis xyz="0 -1 0"/><limit lower="0" upper="0.5" effort="20" velocity="0.1"/><mimic joint="left_joint"/></joint>
</robot>"""
TURNED_RPY = "0 1.57079632679 0"


def with_gripper(urdf: str) -> str:
    """The arm with fingers and a turned `tool0`."""
    straight = '<origin xyz="0 0 0.03" rpy="0 0 0"/>'
    assert straight in urdf
    return urdf.replace(straight, f'<origin xyz="0 0 0.03" rpy="{TURNED_RPY}"/>').replace("</robot>", FINGERS)


@pytest.mark.slow
def test_a_gripper_and_a_turned_flange(newcomer, tmp_path):
    """The same path with fingers in the URDF: its last link is named, and the flange is that of the URDF."""
    her = newcomer(OWN / "bench" / "cell.toml", OWN / "bench" / "payload.toml")
    (tmp_path / "arm.urdf").write_text(with_gripper(known("arm.urdf")), encoding="utf-8")
    shutil.copy(OWN / "bench" / "drive.toml", tmp_path / "drive.toml")
    text = answers(known("answers.toml"), "flange_xyz_m") + 'profile = "drive.toml"\n'
    new = ("cell", "new", "--bus", her.drives.bus, "-o", her.cell, "--answers", her.writes("answers.toml", text))
    refused = command(*new)
    assert refused.exit_code == 3
    assert "--tip hand_link" in refused.stderr
    her.types(*new, "--answer", "tip=hand_link")
    assert "tool0" in str(load_cell(her.cell).cell.arm[0].flange_source)
    her.types("check", her.cell, *LOCKSTEP)
    load = her.measures()
    inside(load, OWN / "bench" / "payload.toml")
    her.counts(load)
    x, y, z = load["com_m"]
    # z of the flange points along x of the last link, x of the flange against its z
    assert np.allclose(load["com_flange_m"], [0.03 - z, y, x], atol=1e-6)
