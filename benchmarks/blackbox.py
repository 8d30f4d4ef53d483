"""Whether every fault that stops an arm leaves a black box that opens and holds what happened.

python -m benchmarks.blackbox [--out out/blackbox] [--kills 10] [kind ..]: simulated drives in lockstep, one stop a
kind. Faults of the master itself run in a process of its own, in real time.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.chaos.killing import few_samples
from benchmarks.chaos.processes import Drives, Job, Master, drives
from benchmarks.chaos.rig import Rig, rig, with_real_pacing
from benchmarks.chaos.scenarios import (
    BY_THE_CLOCK_TOO,
    LOCKSTEP_POSES,
    LOCKSTEP_POSES_LONG,
    Beginning,
    kinds,
    scenario,
    short_plan,
)
from benchmarks.figure import conclude, figure
from benchmarks.program import options
from drives.bus import BusSpec
from drives.errors import DriveError
from gateway.acquire.session import record
from gateway.data.blackbox.box import BlackBox, read_box
from gateway.data.blackbox.ring_buffer import BOTH_KILLED, KILLED, box_of, folder_of, recover_box
from gateway.errors import GatewayError, InputError
from gateway.motion.opening import open_arm
from sim.faults import KINDS

NODE: Final = 3
#: The samples end so shortly before the stop at most [SYNCs]: a drive that does not respond has been waited for.
LATEST_SYNCS: Final = 120
#: In real time: SYNC period, and between how much of a motion and how much the master is dealt with [s].
PERIOD_S: Final = 0.02
MOVED_S: Final = (0.5, 3.0)
#: What may be missing before a kill [s].
MOST_LOST_S: Final = 1.0
#: Time by which a black box must exist, and a master have ended [s].
PATIENCE_S: Final = 60.0
#: Duration of a stop of the master [s].
STALLED_S: Final = 1.5
#: Frames after which the transmit queue takes none any more: the arm moves by then.
FRAMES: Final = 700


@dataclass(frozen=True, slots=True)
class Stop:
    """What one kind left: whether the run was stopped, and what is wrong with its black box (empty = nothing).

    `lost_s`: of a kill, what is missing before it.
    """

    kind: str
    stopped: bool
    wrong: str
    seconds: float = 0.0
    frames: int = 0
    lost_s: float = 0.0


def stopping() -> list[str]:
    """Kinds that stop a moving arm in lockstep."""
    return [kind for kind in kinds() if KINDS[kind].reaction == "stops"]


def stop_by(made: Rig, kind: str, folder: Path) -> Stop:
    """Record until the fault stops the arm, and check the files beside the recording."""
    made.renew()
    fault = scenario(kind, NODE, 1)
    begin = Beginning(made, kind, 1, fault)
    if begin.from_start:
        made.arm(fault)
    path, error = folder / f"{kind}.h5", None
    poses = LOCKSTEP_POSES_LONG if kind in BY_THE_CLOCK_TOO else LOCKSTEP_POSES
    try:
        with open_arm(made.loaded, BusSpec.parse(made.bus)) as opened:
            record(opened, short_plan(opened, 1, poses), "none", path, None, (begin.receive,))
    except (DriveError, GatewayError) as problem:
        error = problem
    if error is None:
        return Stop(kind, False, "")
    try:
        box = read_box(box_of(path))
    except InputError as missing:
        return Stop(kind, True, f"{missing} (stopped by: {error})")
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


def kill_master(master: Master, both: bool) -> float:
    """End the master, and the process that writes as well; when that was (wall clock)."""
    pid = master.process.pid or 0
    beside = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()] if both else []
    killed_s = time.time()
    for each in (*beside, pid):
        with suppress(ProcessLookupError):
            os.kill(each, signal.SIGKILL)
    return killed_s


def stall_master(master: Master) -> float:
    """Stop the master for a while; it ends by itself afterwards."""
    pid = master.process.pid or 0
    os.kill(pid, signal.SIGSTOP)
    time.sleep(STALLED_S)
    os.kill(pid, signal.SIGCONT)
    return 0.0


#: What happens to the master, and how often it is tried for each kill that is asked for.
MASTERS: Final[dict[str, tuple[Callable[[Master], float], float]]] = {
    "master_killed": (lambda master: kill_master(master, both=False), 1.0),
    "both_killed": (lambda master: kill_master(master, both=True), 0.5),
    "master_stalled": (stall_master, 0.0),
    "queue_stays_full": (lambda _master: 0.0, 0.0),
}


def of_masters(kinds: Sequence[str], kills: int, seed: int = 1) -> Iterator[Stop]:
    """Recordings in real time whose master is dealt with while it moves."""
    random, number = np.random.default_rng(seed), 0
    with tempfile.TemporaryDirectory(prefix="blackbox-") as name:
        folder, real = Path(name), with_real_pacing(PERIOD_S)
        with drives(folder, lambda text: real(few_samples(text))) as served:
            for kind in kinds:
                for _ in range(max(1, round(kills * MASTERS[kind][1]))):
                    number += 1
                    frames = FRAMES if kind == "queue_stays_full" else 0
                    job = Job(folder, served.bus, folder / f"run-{number}.h5", frames=frames)
                    yield _of_master(kind, job, served, float(random.uniform(*MOVED_S)))
                    job.ledger.unlink(missing_ok=True)
                    served.ask("renew")


def _of_master(kind: str, job: Job, served: Drives, moved_s: float) -> Stop:
    master = Master(job)
    until_s = time.monotonic() + PATIENCE_S
    while not served.enabled() and not master.end and time.monotonic() < until_s:
        master.listen(time.monotonic() + 0.05)
    if kind != "queue_stays_full":
        master.listen(time.monotonic() + moved_s)
    if master.end:
        return Stop(kind, False, "")
    killed_s = MASTERS[kind][0](master)
    if killed_s:
        master.kill()
    else:
        master.wait(PATIENCE_S)
    path = box_of(job.path)
    while time.monotonic() < until_s and (folder_of(job.path).exists() or not path.with_suffix(".blf").exists()):
        if kind == "both_killed":
            recover_box(job.path)
        time.sleep(0.05)
    try:
        box = read_box(path)
    except InputError as missing:
        return Stop(kind, True, f"{missing} (ended by: {master.end or 'a kill'})")
    ends_s = min(float(box.wall_s[-1]), float(box.frames["time_s"][-1])) if len(box.wall_s) and len(box.frames) else 0.0
    lost_s = killed_s - ends_s if killed_s else 0.0
    reason = {"master_killed": KILLED, "both_killed": BOTH_KILLED}.get(kind)
    said = box.reason == reason if reason else box.reason in master.end
    wrong = "" if said else f"another reason: {box.reason} (ended by: {master.end})"
    if not ends_s or (np.diff(box.sync_index) <= 0).any():
        wrong = "no samples, or out of order"
    elif lost_s > MOST_LOST_S:
        wrong = f"{lost_s:.2f} s are missing"
    return Stop(kind, True, wrong, float(np.ptp(box.time_s)), len(box.frames), lost_s)


def figures(found: Sequence[Stop]) -> dict[str, dict]:
    """Of all kinds that were tried."""
    stopped = [each for each in found if each.stopped]
    good = [each for each in stopped if not each.wrong]
    return {
        "stopping fault kinds tried": figure(len({each.kind for each in found}), ">= 1"),
        "runs": figure(len(found), ">= 1"),
        "of them, runs that were stopped": figure(len(stopped), f"== {len(found)}"),
        "black box present, opens and holds the stop": figure(len(good), f"== {len(stopped)}"),
        "missing before a SIGKILL, longest": figure(
            round(max((each.lost_s for each in found), default=0.0), 2), f"<= {MOST_LOST_S:g}", "s"
        ),
    }


def _in_words(each: Stop) -> Stop:
    """The same, printed."""
    said = each.wrong or ("ok" if each.stopped else "not stopped")
    lost = f", {each.lost_s:.2f} s missing" if each.lost_s else ""
    print(f"{each.kind:24} {each.seconds:6.1f} s {each.frames:7} frames  {said}{lost}", flush=True)
    return each


def main() -> int:
    """Stop once by every kind; exit 1 when a box is missing."""
    parser = options(__doc__, "out/blackbox")
    parser.add_argument("kinds", nargs="*", help="kinds of faults; all that stop an arm by default")
    parser.add_argument("--kills", type=int, default=10, help="of the master by SIGKILL")
    arguments = parser.parse_args()
    found: list[Stop] = []
    wanted = arguments.kinds or [*stopping(), *MASTERS]
    masters = [kind for kind in wanted if kind in MASTERS]
    with ExitStack() as stack:
        made = stack.enter_context(rig())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="blackbox-")))
        for each in (stop_by(made, kind, folder) for kind in wanted if kind not in MASTERS):
            found.append(_in_words(each))
    if masters:
        found += [_in_words(each) for each in of_masters(masters, arguments.kills)]
    return conclude(figures(found), arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
