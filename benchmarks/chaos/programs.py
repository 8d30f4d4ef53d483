"""The command line as a program of its own, beside simulated drives that watch what it does to the axes."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.chaos.processes import Drives, drives, serve_pair
from benchmarks.chaos.rig import with_real_pacing
from benchmarks.fuzz.check_files import RESULT_SEED
from drives.files import read_sealed, write_sealed
from gateway.excite.plan_file import plan_as_plain
from gateway.excite.planning import MovingRequest, make_moving_plan
from gateway.jobs.cell_context import open_cell
from gateway.model.arm_model import arm_robot
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_store import PairStore
from gateway.pair.transform_function import function_of_knots
from sim.serve import free_bus

#: Longest wait for power, and for an end.
POWER_S, END_S = 60.0, 60.0
LOOK_S = 0.01
#: SYNC period of two arms: the example's own, the force inside the part is controlled at it.
PAIR_PERIOD_S = 0.004
#: Wide and quick: axes are near their limits most of the time.
PATH = """name = "swing"
waypoints_rad = [
  [0, 0, 0, 0, 0, 0],
  [0.9, 0.4, -0.3, 0.8, 0.5, 1.2],
  [-0.9, -0.4, 0.3, -0.8, -0.5, -1.2],
  [0, 0, 0, 0, 0, 0],
]
speed_share = 1.0
dwell_s = 0.2
"""
#: Output of a program that was stalled by other work on this computer; it is then run again.
DISTURBED = re.compile(r"stalled for|SYNCs in a row unanswered|timer delay of this computer|SYNCs were delayed")
TRIES = 5
VISIT = re.compile(r"visit \d+/\d+: pose (\d+) from (below|above)")
PERIOD = re.compile(r"period \d+/\d+: '([^']+)' number (\d+)")


class Program:
    """A command that runs; its output is read all the time, until the reader is closed.

    Parameters
    ----------
    words : of the command line, behind `servo-gateway`
    state : folder of ledgers and proofs
    typed : a person may type answers: its input is a terminal
    module : that is run with these words

    Attributes
    ----------
    heard : what it has said, with the monotonic time at which it was read [s]
    """

    def __init__(
        self, words: Sequence[object], state: Path, *, typed: bool = False, module: str = "gateway.cli"
    ) -> None:
        self._keyboard, theirs = os.openpty() if typed else (None, subprocess.DEVNULL)
        self.heard: list[tuple[float, str]] = []
        self._frozen: list[int] = []
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, words)],
            stdin=theirs,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | {"XDG_STATE_HOME": str(state), "XDG_RUNTIME_DIR": str(state)},
            cwd=Path(__file__).resolve().parents[2],
        )
        if typed:
            os.close(theirs)
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._pipes = [self._process.stdout, self._process.stderr]
        for pipe in self._pipes:
            os.set_blocking(pipe.fileno(), False)
        self._said = b""

    @property
    def said(self) -> str:
        """Everything it has said so far."""
        for pipe in self._pipes:
            while part := pipe.read():
                self._said += part
                self.heard.append((time.monotonic(), part.decode(errors="replace")))
        return self._said.decode(errors="replace")

    @property
    def code(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._process.poll()

    @property
    def finished(self) -> set[tuple[int, int] | tuple[str, int]]:
        """(pose, side) of the visits and (motion, number) of the periods that it has announced."""
        visits = {(int(pose), 1 if side == "below" else -1) for pose, side in VISIT.findall(self.said)}
        return visits | {(name, int(number)) for name, number in PERIOD.findall(self.said)}

    def send(self, number: int) -> None:
        """A signal."""
        self._process.send_signal(number)

    def type(self, line: str) -> None:
        """Type a line and press Enter."""
        assert self._keyboard is not None, "its input is no terminal"
        os.write(self._keyboard, f"{line}\n".encode())

    def freeze(self, name: str) -> None:
        """Suspend the processes that it has started whose command line holds a name."""
        for number in _children(self._process.pid):
            with suppress(OSError):
                if name in Path(f"/proc/{number}/cmdline").read_text():
                    os.kill(number, signal.SIGSTOP)
                    self._frozen.append(number)

    def fill_disk(self) -> None:
        """From now on no file can be written, by it or by the processes that it has started."""
        for number in (self._process.pid, *_children(self._process.pid)):
            with suppress(ProcessLookupError):
                resource.prlimit(number, resource.RLIMIT_FSIZE, (1, 1))

    def leave(self) -> None:
        """Close the reading ends of its output, as a terminal that goes away."""
        _ = self.said
        while self._pipes:
            self._pipes.pop().close()

    def wait_for(self, seen: Callable[[], bool], limit_s: float) -> bool:
        """Until something is seen, or it has ended; whether it was seen."""
        until_s = time.monotonic() + limit_s
        while time.monotonic() < until_s:
            _ = self.said
            if seen():
                return True
            if self.code is not None:
                return False
            time.sleep(LOOK_S)
        return False

    def end(self, limit_s: float = END_S) -> int | None:
        """Its exit code; None if it does not end, then it is killed."""
        self.wait_for(lambda: False, limit_s)
        code = self.code
        if code is None:
            self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        for number in self._frozen:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        _ = self.said
        self.leave()
        if self._keyboard is not None:
            os.close(self._keyboard)
            self._keyboard = None
        return code


def _children(process: int) -> list[int]:
    found: list[int] = []
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        with suppress(OSError):
            for child in path.read_text().split():
                found += [int(child), *_children(int(child))]
    return found


def disturbed(said: str) -> bool:
    """Whether a program says that this computer was too busy with something else."""
    return DISTURBED.search(" ".join(said.split())) is not None


def undisturbed(run: Callable[[], tuple[int, str]]) -> tuple[int, str]:
    """Exit code and output of a program in real time; where this computer was too busy, of a later one of `TRIES`."""
    for _ in range(TRIES):
        code, said = run()
        if code == 0 or not disturbed(said):
            break
    return code, said


@dataclass(frozen=True, slots=True)
class Stage:
    """Simulated drives, and where the programs that move them keep their files.

    Attributes
    ----------
    folder : cell and files
    served : the drives
    bus : what `--bus` is given
    pair : two arms
    """

    folder: Path
    served: Drives
    bus: str
    pair: bool = False

    @property
    def cell(self) -> Path:
        """Cell file."""
        return self.folder / "cell.toml"

    @property
    def state(self) -> Path:
        """Ledgers and proofs."""
        return self.folder / "state"

    def run(self, *words: object, typed: bool = False, module: str = "gateway.cli") -> Program:
        """Start a command."""
        return Program([*words, "--bus", self.bus], self.state, typed=typed, module=module)


def _edit(period_s: float) -> Callable[[str], str]:
    real = with_real_pacing(period_s)

    def edit(text: str) -> str:
        text = re.sub(r"samples = \d+", "samples = 10", re.sub(r"count = \d+", "count = 4", real(text)))
        # what an axis lags behind a setpoint by the drives' buffers grows with the period
        return re.sub(r"(?m)^(jerk_limit_rad_s3 = .*)$", r"\1\nfollowing_error_limit_rad = 0.2", text)

    return edit


@contextmanager
def small_stage(
    folder: Path, period_s: float, further: Callable[[str], str] = lambda text: text, **options: Any
) -> Iterator[Stage]:
    """One arm, proven to stop; `further` edits the text of its cell."""
    folder.mkdir(parents=True, exist_ok=True)
    edit = _edit(period_s)
    with drives(folder, lambda text: further(edit(text)), **options) as served:
        (folder / "path.toml").write_text(PATH)
        robot = arm_robot(served.loaded, served.loaded.cell.arm[0]).name
        known = json.loads(RESULT_SEED.replace(b"21.0", b"6.0"))
        (folder / "load.json").write_text(json.dumps(known | {"robot": robot}))
        stage = Stage(folder, served, served.bus)
        yield prove(stage)


@contextmanager
def pair_stage(folder: Path, period_s: float, bus: str, **options: Any) -> Iterator[Stage]:
    """Two arms that grip a part between them, at the start of their path."""
    folder.mkdir(parents=True, exist_ok=True)
    with drives(folder, with_real_pacing(period_s), bus, serve=serve_pair, **options) as served:
        yield Stage(folder, served, bus, pair=True)


def pair_bus() -> str:
    """Two free buses for the example's two arms."""
    return f"left={free_bus()};right={free_bus()}"


#: What the program keeps of drives that stop, by the cell file of the drives and by arm.
_PROOFS: dict[bytes, dict[str, bytes]] = {}


def prove(stage: Stage) -> Stage:
    """Have the program prove once for each cell file that the drives stop, so that it need not do so at every start.

    A motion is noted as done, so that the first one is as fast as any other.
    """
    context, proofs = open_cell(stage.cell, stage.bus, lambda _spec: None), stage.state / "servo-gateway"
    files = {arm.name: proofs / context.stop_proof(arm).name for arm in context.arms}
    kept = _PROOFS.get(stage.cell.read_bytes())
    if kept is not None:
        proofs.mkdir(parents=True, exist_ok=True)
        for name, path in files.items():
            path.write_bytes(kept[name])
        return stage
    if stage.pair:
        stage.served.ask("grip", True)

    def check() -> tuple[int, str]:
        program = stage.run("check", stage.cell, "--prove-stop", "--yes")
        code = program.end(120.0)
        if code and not stage.pair:
            stage.served.ask("renew")
        return code, program.said

    code, said = undisturbed(check)
    if code:
        raise RuntimeError(f"the stop is not proven: {said}")
    for path in files.values():
        write_sealed(path, read_sealed(path) | {"moved": True})
    _PROOFS[stage.cell.read_bytes()] = {name: path.read_bytes() for name, path in files.items()}
    if stage.pair:
        stage.served.ask("grip", False)
    return stage


def teach(stage: Stage) -> None:
    """A first function, as if taught: the relation of the grasps."""
    pair = load_pair(stage.cell)
    function = function_of_knots([0.0, pair.path().length_m], [pair.nominal_relation] * 2)
    PairStore(pair, stage.cell.with_suffix(".pair")).save("first", function, learn_source="taught", speed=0.0)


@dataclass(frozen=True, slots=True)
class Command:
    """A command that moves.

    Attributes
    ----------
    name : as printed
    words : of the command line, given the stage and a folder for what is written
    window_s : how long after power something may happen to it
    pair : it needs two arms
    records : it announces visits or periods, which are in `run.h5`
    writes : it writes files while it is under power
    """

    name: str
    words: Callable[[Stage, Path], list[object]]
    window_s: float
    pair: bool = False
    records: bool = False
    writes: bool = False


def _follow(stage: Stage, _out: Path) -> list[object]:
    load = stage.folder / "load.json"
    return ["follow", stage.cell, "--path", stage.folder / "path.toml", load, "--yes", "-v"]


def _in_motion(stage: Stage, out: Path) -> list[object]:
    """Periods of a series of all joints by chance, each scaled up to its first limit."""
    plan = stage.folder / "motion.json"
    if not plan.exists():
        request = MovingRequest(choice="random", period_s=5.0, periods=3)
        plan.write_text(json.dumps(plan_as_plain(make_moving_plan(stage.served.loaded, None, request))))
    return ["record", stage.cell, "--load", "none", "--plan", plan, "-o", out / "run.h5", "--yes", "-v"]


COMMANDS = (
    Command(
        "record",
        lambda stage, out: ["record", stage.cell, "--load", "none", "-o", out / "run.h5", "--yes", "-v"],
        8.0,
        records=True,
        writes=True,
    ),
    Command(
        "commission",
        lambda stage, out: ["commission", stage.cell, "--load", "tool", "-o", out, "--yes", "-v"],
        8.0,
        records=True,
        writes=True,
    ),
    Command("record --plan", _in_motion, 12.0, records=True, writes=True),
    Command("check --move", lambda stage, out: ["check", stage.cell, "--move", "--yes", "-v"], 5.0),
    Command("check --prove-stop", lambda stage, out: ["check", stage.cell, "--prove-stop", "--yes", "-v"], 4.0),
    Command("follow", _follow, 8.0),
    Command(
        "pair teach", lambda stage, out: ["pair", "teach", stage.cell, "--yes", "--store", out], 12.0, True, writes=True
    ),
    Command("pair run", lambda stage, out: ["pair", "run", stage.cell, "--yes", "--cycles", "2", "-v"], 5.0, True),
)
