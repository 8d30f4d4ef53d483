"""Whether every fault that stops an arm leaves a black box that opens and holds what happened.

python -m benchmarks.blackbox [--out out/blackbox] [kind ..]: simulated drives in lockstep, one stop a kind.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.chaos.rig import Rig, rig
from benchmarks.chaos.scenarios import (
    BY_THE_CLOCK_TOO,
    DETAILS,
    LOCKSTEP_POSES,
    LOCKSTEP_POSES_LONG,
    Beginning,
    kinds,
    short_plan,
)
from benchmarks.figure import figure
from drives.bus import BusSpec
from drives.errors import DriveError
from gateway.acquire.session import RecordRequest, record
from gateway.data.blackbox.box import BlackBox, read_box
from gateway.data.blackbox.ring import box_of
from gateway.errors import GatewayError, InputError
from gateway.motion.opening import BusOverride, open_arm
from sim.faults import KINDS, Fault

NODE: Final = 3
#: The samples end so shortly before the stop at most [SYNCs]: what is silent has been waited for.
LATEST_SYNCS: Final = 120


@dataclass(frozen=True, slots=True)
class Stop:
    """What one kind left: whether the run was stopped, and what is wrong with its black box (empty = nothing)."""

    kind: str
    stopped: bool
    wrong: str
    seconds: float = 0.0
    frames: int = 0


def stopping() -> list[str]:
    """Kinds that stop a moving arm in lockstep."""
    return [kind for kind in kinds() if KINDS[kind].reaction_in("lockstep") == "stops"]


def stop_by(made: Rig, kind: str, folder: Path) -> Stop:
    """Record until the fault stops the arm, and look at what lies beside the recording."""
    made.renew()
    fault = Fault(kind, **({"node": NODE, "seed": 1} | DETAILS.get(kind, {})))
    begin = Beginning(made, kind, 1, fault)
    if begin.from_start:
        made.arm(fault)
    path, error = folder / f"{kind}.h5", None
    poses = LOCKSTEP_POSES_LONG if kind in BY_THE_CLOCK_TOO else LOCKSTEP_POSES
    try:
        with open_arm(made.loaded, BusOverride(BusSpec.parse(made.bus))) as opened:
            record(opened, short_plan(opened, 1, poses), RecordRequest("none", path), (begin.hear,))
    except (DriveError, GatewayError) as problem:
        error = problem
    if error is None:
        return Stop(kind, False, "")
    try:
        box = read_box(box_of(path))
    except InputError as missing:
        return Stop(kind, True, str(missing))
    held_s = float(np.ptp(box.time_s)) if len(box.time_s) else 0.0
    return Stop(kind, True, _wrong(box, str(error), begin.start, kind), held_s, len(box.frames))


def _wrong(box: BlackBox, error: str, began: int, kind: str) -> str:
    """What the box lacks."""
    if box.reason != error:
        return f"another reason: {box.reason}"
    if not len(box.frames) or not box.path.with_suffix(".blf").exists():
        return "no frames"
    if len(box.sync_index) and (np.diff(box.sync_index) <= 0).any():
        return "samples out of order"
    ids, data = box.frames["can_id"], box.frames["data"]
    if kind.startswith("emcy") and not (ids == 0x80 + NODE).any():
        return "no emergency message"
    if kind == "drive_fault" and not ((ids == 0x180 + NODE) & (data[:, 0] & 0x08 > 0)).any():
        return "no statusword of the fault"
    if kind == "boot_up_frame" and not ((ids == 0x700 + NODE) & (data[:, 0] == 0)).any():
        return "no boot-up frame"
    syncs = int((ids == 0x80).sum())
    if began and syncs + LATEST_SYNCS < len(box.sync_index):
        return f"{syncs} SYNC frames for {len(box.sync_index)} samples"
    return ""


def figures(found: Sequence[Stop]) -> dict[str, dict]:
    """Of all kinds that were tried."""
    stopped = [each for each in found if each.stopped]
    good = [each for each in stopped if not each.wrong]
    return {
        "stopping fault kinds tried": figure(len(found), ">= 1"),
        "of them, runs that were stopped": figure(len(stopped), f"== {len(found)}"),
        "black box present, opens and holds the stop": figure(len(good), f"== {len(stopped)}"),
    }


def main(argv: list[str]) -> int:
    """Stop once by every kind; exit 1 when a box is missing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blackbox", description=__doc__)
    parser.add_argument("kinds", nargs="*", help="kinds of faults; all that stop an arm by default")
    parser.add_argument("--out", type=Path, default=Path("out/blackbox"))
    arguments = parser.parse_args(argv)
    found: list[Stop] = []
    with rig() as made, tempfile.TemporaryDirectory(prefix="blackbox-") as folder:
        for kind in arguments.kinds or stopping():
            found.append(stop_by(made, kind, Path(folder)))
            each = found[-1]
            said = each.wrong or ("ok" if each.stopped else "not stopped")
            print(f"{kind:24} {each.seconds:6.1f} s {each.frames:7} frames  {said}", flush=True)
    told = figures(found)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "summary.json").write_text(json.dumps({"figures": told}, indent=1) + "\n")
    for name, each in told.items():
        print(f"{name}: {each['value']} ({each['goal']})")
    return 0 if all(each["met"] for each in told.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
