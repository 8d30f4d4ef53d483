"""Fixtures for the commands against drives on another stack: a bus, the drives' process, a folder with the cell."""

from __future__ import annotations

import json
import os
import shutil
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from benchmarks.chaos.programs import undisturbed
from gateway.cli import main
from gateway.preflight import machine
from tests.support.independent_drives import SIX, IndependentDrives

HERE = Path(__file__).parent
#: Forms of SDO answers, in mode 8; the third variant of the drives moves in mode 7.
VARIANTS = ("zero-extended", "no-size")
EMULATED = os.environ.get("SERVO_GATEWAY_IN_VM") == "1"
#: What is changed in the profile where the processor is emulated, a twentieth as fast: (old, new).
PATIENTLY = [("\ntimeout_s = 0.5", "\ntimeout_s = 10.0"), ("slow_timeout_s = 3.0", "slow_timeout_s = 20.0")]


@dataclass(frozen=True)
class Place:
    """A folder with the cell of these drives, and the commands that an engineer types in it."""

    folder: Path
    bus: str

    @property
    def cell(self) -> Path:
        return self.folder / "cell.toml"

    def types(self, *words: object, bus: bool = True, code: int = 0, output: Path | None = None) -> None:
        """A command that has to end with this exit code, again where this computer was too busy to move."""
        where = [*(("--bus", self.bus) if bus else ()), *(("-o", output) if output else ())]

        def run() -> tuple[int, str]:
            if output:
                output.unlink(missing_ok=True)
            done = CliRunner().invoke(main, [str(word) for word in (*words, *where)])
            return done.exit_code, done.output

        ended, said = undisturbed(run)
        assert ended == code, said

    def result(self, *words: object, bus: bool = True, code: int = 0) -> dict[str, Any]:
        """What a command writes as JSON."""
        path = self.folder / "out.json"
        self.types(*words, "--json", path, bus=bus, code=code)
        return json.loads(path.read_text(encoding="utf-8"))


def _change(path: Path, changes: Sequence[tuple[str, str]]) -> None:
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def on_buses(udp: Sequence[str], socketcan: Sequence[str] = ()) -> pytest.MarkDecorator:
    """Give a test drives of these variants; on SocketCAN of few, since each start takes long where it is emulated."""
    on_can = (pytest.param("socketcan", variant, marks=pytest.mark.vcan) for variant in socketcan)
    on_udp = (("udp_multicast", variant) for variant in udp)
    return pytest.mark.parametrize(("bus", "drives"), [*on_udp, *on_can], indirect=True)


@pytest.fixture(scope="module")
def bus(request: pytest.FixtureRequest) -> str:
    """A bus of its own."""
    if request.param == "socketcan":
        return f"socketcan:{request.getfixturevalue('vcan')}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    return f"udp_multicast:239.74.163.9,port={port}"


@pytest.fixture(scope="module")
def drives(request: pytest.FixtureRequest, bus: str) -> Iterator[IndependentDrives]:
    """Drives of one vendor variant; on the nodes of the module, six by default."""
    with IndependentDrives(bus, getattr(request.module, "NODES", SIX), request.param) as running:
        yield running


@pytest.fixture(scope="module")
def place(drives: IndependentDrives, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """The cell beside a profile that was drafted from the data sheet."""
    folder = tmp_path_factory.mktemp("independent")
    for name in ("cell.toml", "robot.urdf", "drive.eds", "answers.toml"):
        shutil.copy(HERE / name, folder / name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        # Whether this computer is idle enough has a test of its own; a delayed SYNC in motion still ends a command.
        patch.setattr(machine, "measure_lateness", lambda *_: [0.0])
        if drives.variant == "interpolated":
            _change(
                folder / "drive.eds",
                [("DefaultValue=0x80\nPDOMapping=0\n\n[Ma", "DefaultValue=0x40\nPDOMapping=0\n\n[Ma")],
            )
        here = Place(folder, drives.bus)
        words = ("--eds", folder / "drive.eds", "--answers", folder / "answers.toml", "-o", folder / "axd.toml")
        here.types("profiles", "new", *words, bus=False)
        if EMULATED:
            _change(folder / "axd.toml", PATIENTLY)
        yield here


@pytest.fixture
def failed() -> Callable[[dict[str, Any]], list[str]]:
    """What a check found wrong, in words."""
    return lambda report: [
        f"{line['where']}: {line['what']}" for line in report["findings"] if line["severity"] == "fail"
    ]
