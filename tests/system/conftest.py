"""The gateway's command line against simulated drives, in one process on a virtual bus: a small arm, few poses."""

from __future__ import annotations

import json
import re
import shutil
import sys
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import Result

from gateway.cli import main
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import Recording
from sim.serve import RunningSimulation, running
from tests.support.rigs.command_line import run as command
from tests.support.rigs.pacing import SHORTLY, in_lockstep, measured_shortly
from tests.support.rigs.proofs import keep_proof_of_stop

SMALL = Path(__file__).parents[2] / "examples" / "small"
POSES = """[poses]
count = 4
approach_offset_rad = 0.03
approach_speed_rad_s = 0.1
samples = 10
validation = 2
seed = 2
"""


@dataclass(frozen=True)
class Place:
    """A folder with cell, robot and payload."""

    folder: Path

    @property
    def cell(self) -> Path:
        return self.folder / "cell.toml"

    @property
    def payload(self) -> Path:
        return self.folder / "payload.toml"

    @property
    def run(self) -> Path:
        return self.folder / "run.h5"

    def recording(self) -> Recording:
        return read(self.run)

    def variant(self, name: str, *changes: tuple[str, str]) -> Path:
        """A cell file that differs: each (old, new) replaces the first occurrence of `old`."""
        text = self.cell.read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        path = self.folder / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return path


def with_few_poses(place: Place) -> None:
    """No visits to fresh poses, for tests of a command's sequence and not of the accuracy.

    Loads are mounted where the arm is, not at a posture to which it would go at a tenth of its speed. With fewer than
    four poses a diagnosis asks for further ones.
    """
    text = re.sub(r"(?m)^loading_rad = .*\n", "", place.cell.read_text(encoding="utf-8"))
    assert "validation = 2" in text
    place.cell.write_text(text.replace("validation = 2", "validation = 0", 1), encoding="utf-8")


@dataclass(frozen=True)
class Drives:
    """Simulated drives that run."""

    handle: RunningSimulation

    @property
    def bus(self) -> str:
        return self.handle.bus

    @property
    def mount(self) -> Callable[[str], None]:
        return self.handle.mount

    def stand_still(self) -> bool:
        """No drive is energised: every joint is in its brake."""
        (arm,) = self.handle.simulation.arms
        return not any(drive.automaton.energised for drive in arm.drives)


@pytest.fixture(autouse=True)
def _ledgers_apart(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def place(tmp_path) -> Place:
    """A small cell with few poses."""
    for name in ("robot.urdf", "payload.toml"):
        shutil.copy(SMALL / name, tmp_path / name)
    text = (SMALL / "cell.toml").read_text(encoding="utf-8")
    (tmp_path / "cell.toml").write_text(in_lockstep(text[: text.index("[poses]")]) + POSES, encoding="utf-8")
    return Place(tmp_path)


@pytest.fixture
def fast_cell(place) -> None:
    """The small cell with an arm that moves faster."""
    text = place.cell.read_text(encoding="utf-8")
    few = {"samples": 10, "count": 4}
    place.cell.write_text(measured_shortly(text, SHORTLY | few), encoding="utf-8")


@pytest.fixture
def fast_arm(place, fast_cell, tmp_path_factory) -> Callable[[Drives], Drives]:
    """Keep a proof that the drives of the fast cell stop.

    Without it a command proves the stop first and then moves at a tenth of its speed, which other tests are about.
    """

    def proven(drives: Drives, cell: Path | None = None) -> Drives:
        keep_proof_of_stop(cell or place.cell, drives.bus, tmp_path_factory)
        return drives

    return proven


@pytest.fixture
def serve(place) -> Iterator[Callable[..., Drives]]:
    """Start simulated drives of the small cell; `fault` and `effect` are TOML texts."""
    with ExitStack() as stack:

        @contextmanager
        def started(**options: object) -> Iterator[Drives]:
            bus = f"virtual:system-{uuid.uuid4().hex}"
            with running(place.cell, bus, payload=place.payload, **options) as handle:
                yield Drives(handle)

        def start(fault: str = "", effect: str = "", pacing: str = "lockstep") -> Drives:
            options: dict[str, object] = {"pacing": pacing}
            for key, text in (("fault", fault), ("undeclared", effect)):
                if text:
                    path = place.folder / f"{key}.toml"
                    path.write_text(text, encoding="utf-8")
                    options[key] = (path,) if key == "fault" else path
            return stack.enter_context(started(**options))

        yield start


class Hands:
    """Replacement of stdin: mounts the load that was asked for, or forgets it, then types its label."""

    def __init__(self, drives, capsys, mounts, forgets):
        self.drives, self.capsys, self.mounts, self.forgets = drives, capsys, mounts, forgets
        self.asked, self.said = [], ""

    def readline(self):
        if not self.mounts:
            return ""
        self.said += self.capsys.readouterr().out
        label = self.said.rsplit("HANG LOAD ", 1)[1].split()[0]
        assert self.drives.stand_still()
        self.asked.append(label)
        if not self.forgets:
            self.drives.mount(label)
        return f"{label}\n"

    def isatty(self):
        return False


@pytest.fixture
def guided(place, monkeypatch, capsys):
    """Run a guided command in this process; exit code, hands, and what was said."""

    def run(command, drives, *more, mounts=True, forgets=False):
        hands = Hands(drives, capsys, mounts, forgets)
        monkeypatch.setattr(sys, "stdin", hands)
        arguments = [command, place.cell, "--bus", drives.bus, "--yes", "-o", place.folder / "out", *more]
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        return left.value.code, hands, capsys.readouterr()

    return run


@pytest.fixture
def commission(place, guided):
    """Run `commission` in this process and return exit code, result and what was said."""

    def run(drives, *more, mounts=True, forgets=False):
        code, hands, output = guided("commission", drives, *more, mounts=mounts, forgets=forgets)
        path = place.folder / "out" / "result.json"
        result = json.loads(path.read_text()) if path.exists() else None
        return code, result, hands, output

    return run


@pytest.fixture
def gateway() -> Callable[..., Result]:
    """Run the command line."""
    return command
