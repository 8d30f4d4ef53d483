"""Defects of one simulated drive that `drive test` has to find on that drive and on no other."""

from __future__ import annotations

import json
import random
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from click.testing import CliRunner

from gateway.cli import main
from sim.serve import running

SMALL: Final = Path(__file__).parents[2] / "examples" / "small"
#: Drive with the defect, from 0.
DEFECTIVE: Final = 1

Drive = Any
Arm = Any


def _answers_unknown_object(drive: Drive, _arm: Arm) -> None:
    drive.store.constant((0x0FFF, 0), "u32", 0)


def _answers_unknown_subindex(drive: Drive, _arm: Arm) -> None:
    drive.store.constant((0x1018, 0xF0), "u32", 0)
    read = drive.store.read
    drive.store.read = lambda index, sub: b"\0\0\0\0" if index == 0x1018 and sub > 4 else read(index, sub)


def _accepting(index: int) -> Callable[[Drive, Arm], None]:
    """Return the defect that any write to an object is acknowledged and ignored."""

    def build(drive: Drive, _arm: Arm) -> None:
        write = drive.store.write
        drive.store.write = lambda at, sub, data: None if at == index and len(data) == 4 else write(at, sub, data)

    return build


def _no_emergency(drive: Drive, _arm: Arm) -> None:
    drive.node.emergency = lambda *_, **__: None


def _flat_ramp(drive: Drive, _arm: Arm) -> None:
    steep = drive.joint_ramp
    drive.joint_ramp = lambda word: steep(word) / 60.0


def _old_torque(drive: Drive, arm: Arm) -> None:
    kept, measure = deque[float](maxlen=3), arm._measure

    def delayed() -> None:
        measure()
        kept.append(drive.reading_nm)
        drive.reading_nm = kept[0]

    arm._measure = delayed


def _loses_tpdos(drive: Drive, _arm: Arm) -> None:
    transmit, draw = drive.transmit, random.Random(7)
    drive.transmit = lambda tpdo: None if draw.random() < 0.03 else transmit(tpdo)


def _heartbeat_ignored(drive: Drive, _arm: Arm) -> None:
    drive.node.on_heartbeat_lost = lambda _node: None


def _nmt_stop_ignored(drive: Drive, _arm: Arm) -> None:
    obeyed = drive.node.nmt_command
    drive.node.nmt_command = lambda command: None if command == 2 else obeyed(command)


def _reserved_capability(drive: Drive, _arm: Arm) -> None:
    drive.store.constant((0x1010, 1), "u32", 0x81)


def _shortcut(drive: Drive, _arm: Arm) -> None:
    command = drive.automaton.command

    def direct(word: int) -> None:
        command(0x06 if word == 0x07 else word)
        command(word)

    drive.automaton.command = direct


def _brake_slips(drive: Drive, _arm: Arm) -> None:
    drive.axis.slip_rad_s = 0.05


def _slow_controlword(drive: Drive, _arm: Arm) -> None:
    take, waiting = drive.take_controlword, deque[int]()

    def delayed(word: int) -> None:
        waiting.append(word)
        if len(waiting) > 4:
            take(waiting.popleft())

    drive.take_controlword = delayed


DEFECTS: Final[Mapping[str, Callable[[Drive, Arm], None]]] = {
    "answers an object that does not exist": _answers_unknown_object,
    "answers a subindex that does not exist": _answers_unknown_subindex,
    "acknowledges a write to a constant": _accepting(0x1000),
    "acknowledges a write of the wrong length": _accepting(0x1017),
    "sends no EMCY": _no_emergency,
    "ramp flatter than 0x6085": _flat_ramp,
    "torque word two SYNCs old": _old_torque,
    "loses 3 % of its TPDOs": _loses_tpdos,
    "goes on without the master's heartbeat": _heartbeat_ignored,
    "ignores NMT stop": _nmt_stop_ignored,
    "reserved bits in 0x1010": _reserved_capability,
    "enables by one controlword": _shortcut,
    "brake slips": _brake_slips,
    "controlword acts four SYNCs after its frame": _slow_controlword,
}


def tested(name: str, bus: str) -> dict[str, Any]:
    """Run the test of all drives in lockstep, one with a defect ("" for none); return exit code and findings."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        shutil.copytree(SMALL, folder / "small")
        cell = folder / "small" / "cell.toml"
        with running(cell, bus, payload=SMALL / "payload.toml", pacing="lockstep") as handle:
            arm = handle.simulation.arms[0]
            if name:
                DEFECTS[name](arm.drives[DEFECTIVE], arm)
            out = folder / "out"
            words = ["drive", "test", str(cell), "--bus", bus, "--pacing", "lockstep", "--yes", "-o", str(out)]
            done = CliRunner(env={"XDG_STATE_HOME": str(folder / "state")}).invoke(main, words)
        reports = [json.loads(path.read_text()) for path in sorted(out.glob("J*.json"))]
    findings = {report["axis"]: report["findings"] for report in reports if report["findings"]}
    return {"defect": name, "exit": done.exit_code, "findings": findings, "message": done.stderr[-300:]}


def is_found(answer: Mapping[str, Any]) -> bool:
    """Return whether the defective drive alone has findings, or the command refused it by its name."""
    axis = f"J{DEFECTIVE + 1}"
    if answer["findings"]:
        return set(answer["findings"]) == {axis}
    return answer["exit"] in (4, 7) and axis in answer["message"]


def run_all(_seed: int = 0) -> list[dict[str, Any]]:
    """Return the answers without a defect and with each defect."""
    return [tested(name, f"virtual:defects-{number}") for number, name in enumerate(("", *DEFECTS))]


if __name__ == "__main__":
    for each in run_all():
        print(json.dumps(each | {"found": is_found(each)}), flush=True)
