"""One fault at a random instant of a short run, and whether it ends in its stated reaction.

The run is the real one (plan, stream, watch, drive group); what the drives did is seen from their own side.
"""

from __future__ import annotations

import errno
import random
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import can
import numpy as np

from drives.errors import DriveError
from gateway.acquire.events import Event, Started
from gateway.acquire.plan import Plan
from gateway.acquire.planning import plan_of_poses
from gateway.acquire.poses import RestPose
from gateway.acquire.run import Station
from gateway.acquire.runner import RunRequest, run_plan
from gateway.check.moves import check_moves
from gateway.check.preflight import check_arm
from gateway.check.stop import prove_stop
from gateway.errors import GatewayError
from gateway.motion.opening import OpenArm
from gateway.visit import Visit
from sim.faults import KINDS, Fault
from sim.states import PdsState
from tests.chaos.rig import Rig

#: SYNCs from the first word of a stop to the last axis that is no longer enabled.
SAFE_BOUND = 5
ENABLED_WORD = 0x000F
ENABLED = PdsState.OPERATION_ENABLED
RATED_TORQUE = 0x6076

#: What a kind needs beyond its node.
DETAILS: dict[str, dict[str, Any]] = {
    "tpdo_lost": {"syncs": 3},
    "tpdo_gone": {"syncs": 0},
    "tpdo_duplicated": {"syncs": 50},
    "tpdo_delayed": {"syncs": 20},
    "tpdo_reordered": {"node": 0, "syncs": 0},
    "tpdo_stuck": {"syncs": 0},
    "burst": {"syncs": 2},
    "tpdo_random_loss": {"node": 0, "syncs": 0, "share": 0.002},
    "rpdo_lost": {"syncs": 2},
    "rpdo_gone": {"syncs": 0},
    "sync_lost": {"node": 0},
    "heartbeat_lost": {"syncs": 0},
    "heartbeat_back": {"syncs": 900},
    "internal_limit": {"syncs": 0},
    "following_error": {"syncs": 0},
    "not_remote": {"syncs": 0},
    "warning": {"syncs": 0},
    "torque_spike": {"syncs": 0, "code": 1500},
    "second_master_sync": {"syncs": 0},
    "second_master_nmt": {"syncs": 0},
    "second_master_sdo": {"syncs": 0},
    "error_frames": {"syncs": 20},
    "error_passive": {"syncs": 20},
    "strange_frames": {"syncs": 20},
    "sdo_late": {"syncs": 0, "count": 5, "delay_s": 0.1},
    "sdo_too_late": {"syncs": 0, "count": 1, "index": RATED_TORQUE, "delay_s": 0.8},
    "sdo_lost": {"syncs": 0, "count": 1, "index": RATED_TORQUE},
    "sdo_silent": {"syncs": 0},
    "sdo_aborted": {"syncs": 0, "index": 0x6060},
    "sdo_other_object": {"syncs": 0, "index": RATED_TORQUE},
    "sdo_wrong_toggle": {"syncs": 0, "count": 1},
    "sdo_short": {"syncs": 0},
    "node_missing": {"syncs": 0},
    "duplicate_node": {"syncs": 0},
}
#: Faults that show late, or only while the axis moves, begin in the first motion.
IN_MOTION = frozenset({"tpdo_stuck", "rpdo_gone", "brake_engaged", "heartbeat_lost", "heartbeat_back"})
#: SYNCs after the start at which a fault begins; the torque is watched once the brakes have handed over the load.
EARLY, TAKEN_OVER, ANY = (5, 20), (35, 250), (5, 250)
#: Faults of the whole bus: the message cannot name a node.
NAMELESS = ("second_master", "bus_off")
BEFORE = frozenset({"refuses", "finding"})
#: Kinds that the drives themselves have to stop, or that need a process of their own: see `tests.chaos.killing`.
ELSEWHERE = frozenset({"queue_stays_full", "master_killed", "master_stalled", "disk_full"})


@dataclass(slots=True)
class Outcome:
    """What came of one fault.

    Attributes
    ----------
    kind, seed : which
    complaints : what was not as stated; empty = ended in its stated reaction
    detected, safe : SYNCs from the fault to the first word of a stop, and from there to the last axis out of operation
    moved : axes and SYNCs at which an enabled axis was given a new target after that first word
    wrong : recorded values that no drive had shown at that SYNC or the one before
    recorded : values compared
    error : what the engineer is told
    """

    kind: str
    seed: int
    complaints: list[str] = field(default_factory=list)
    detected: int | None = None
    safe: int | None = None
    moved: int = 0
    wrong: int = 0
    recorded: int = 0
    error: str = ""

    @property
    def fine(self) -> bool:
        """Whether it ended in its stated reaction."""
        return not self.complaints


class Shelf:
    """Visits of one run, in memory."""

    def __init__(self) -> None:
        self.visits: list[Visit] = []

    def add(self, arm: str, visit: Visit) -> Visit:
        """Keep a visit."""
        self.visits.append(visit)
        return visit


def kinds() -> Iterable[str]:
    """Kinds that are carried out here."""
    return (kind for kind in KINDS if kind not in ELSEWHERE)


def short_plan(opened: OpenArm, seed: int) -> Plan:
    """Two rest poses, each from both sides; every joint travels on the way to the first one."""
    rng = random.Random(seed)
    first = tuple(-float(np.sign(angle) or 1.0) * rng.uniform(0.25, 0.35) for angle in opened.arm.where())
    second = tuple(0.5 * angle for angle in first)
    poses = [RestPose(1, first, "fit"), RestPose(2, second, "fit")]
    return plan_of_poses(opened.loaded, opened.config, opened.workspace, poses)


def play(rig: Rig, kind: str, seed: int) -> Outcome:
    """One fault at an instant drawn from the seed.

    Parameters
    ----------
    rig : Rig
        Simulated drives that run; they are as after power-up when this returns.
    kind : str
        One of `kinds()`.
    seed : int
    """
    rig.renew()
    outcome = Outcome(kind, seed)
    rng = random.Random(f"{kind} {seed}")
    fault = None
    if KINDS[kind].where != "master":
        fault = Fault(kind, **({"node": rng.randint(1, 6), "seed": seed} | DETAILS.get(kind, {})))
    about = KINDS[kind]
    before = about.where == "object" or about.reaction in BEFORE or kind.startswith("sdo_")
    shelf = Shelf()
    base = start = 0
    error: Exception | None = None

    def begin(event: Event) -> None:
        nonlocal start
        if isinstance(event, Started) and not before:
            offset = rng.randint(*(TAKEN_OVER if kind == "torque_spike" else EARLY if kind in IN_MOTION else ANY))
            start = rig.wire.sync + offset
            if fault is not None:
                rig.wire.arm_in(fault, offset)

    if before and fault is not None:
        arm = fault
        rig.call(lambda: rig.wire.arm(arm))
    finding = ""
    try:
        with rig.open() as opened:
            if KINDS[kind].reaction == "finding":
                finding = look(opened)
            else:
                base = rig.wire.sync
                if kind == "queue_full":
                    fill_queue(opened, rng)
                station = Station(opened.arm, opened.workspace, shelf, (begin,))
                run_plan(station, RunRequest(short_plan(opened, seed), "none"))
    except (DriveError, GatewayError) as problem:
        error = problem
    outcome.error = finding or str(error or "")
    rig.call(lambda: None)
    judge(rig, outcome, fault, error, finding)
    follow(rig, outcome, fault, start)
    compare(rig, outcome, shelf, base)
    rig.renew()
    return outcome


def look(opened: OpenArm) -> str:
    """First failing item of the pre-flight check: at rest, then without heartbeat, then by small moves."""
    for items in (
        lambda: check_arm(opened.group.bus, opened.config, opened.profiles),
        lambda: prove_stop(opened).items,
        lambda: check_moves(opened).items,
    ):
        failing = [item for item in items() if item.severity == "fail"]
        if failing:
            return str(failing[0])
    return ""


def fill_queue(opened: OpenArm, rng: random.Random) -> None:
    """Let the adapter refuse a frame now and then, as a full transmit queue does."""
    adapter = opened.group._bus._adapter
    send = adapter.send

    def refuse(frame: can.Message, timeout: float | None = None) -> None:
        if rng.random() < 0.002:
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        send(frame, timeout)

    opened.group._bus._adapter = _With(adapter, refuse)


class _With:
    """An adapter with another `send`."""

    def __init__(self, adapter: Any, send: Callable[..., None]) -> None:
        self._adapter = adapter
        self.send = send

    def __getattr__(self, name: str) -> Any:
        return getattr(self._adapter, name)


def judge(rig: Rig, outcome: Outcome, fault: Fault | None, error: Exception | None, finding: str) -> None:
    """The stated reaction against what happened."""
    about = KINDS[outcome.kind]
    complain = outcome.complaints.append
    if fault is not None and not rig.wire.touched.get(outcome.kind):
        complain("the fault touched nothing")
    if about.reaction in ("goes on", "retried") and error is not None:
        complain(f"the run ended: {error}")
    if about.reaction in ("stops", "refuses") and error is None:
        complain("no error was raised")
    if about.reaction == "finding" and not (finding or error):
        complain("the check found nothing")
    if about.reaction == "refuses" and any(ENABLED in states for _, states, _, _ in rig.seen.states):
        complain("an axis was enabled")
    said = finding or str(error)
    anybody = fault is None or not fault.node or fault.kind.startswith(NAMELESS)
    named = anybody or any(f"{word} {fault.node}" in said for word in ("node", "joint") if fault is not None)
    if about.reaction in ("stops", "refuses", "finding") and said and not named:
        complain(f"the message does not name the node: {error}")
    states = [drive.automaton.state for drive in rig.server.drives if not drive.node.silent]
    if ENABLED in states:
        complain("an axis is still enabled at the end")


def follow(rig: Rig, outcome: Outcome, fault: Fault | None, start: int) -> None:
    """Detection, time to a safe state and targets after it, from the drives' side."""
    if KINDS[outcome.kind].reaction != "stops":
        return
    healthy = [axis for axis in range(6) if fault is None or fault.node != axis + 1]
    after = [each for each in rig.seen.states if each[0] > start]
    stop = next((each for each in after if any(each[3][axis] != ENABLED_WORD for axis in healthy)), None)
    if stop is None:
        outcome.complaints.append("no drive was told to stop")
        return
    told = stop[0] - 1
    outcome.detected = told - start
    bound = KINDS[outcome.kind].bound
    if bound is not None and outcome.detected > bound:
        outcome.complaints.append(f"told after {outcome.detected} SYNCs, {bound} are stated")
    rest = [each for each in after if each[0] > told]
    safe = next((each[0] for each in rest if all(each[1][axis] is not ENABLED for axis in healthy)), None)
    if safe is None:
        last = rig.seen.states[-1][0] + 1
        safe = last if not any(rig.server.drives[axis].automaton.state is ENABLED for axis in healthy) else None
    if safe is None:
        outcome.complaints.append("an axis never left OPERATION ENABLED")
        return
    outcome.safe = safe - told
    if outcome.safe > SAFE_BOUND:
        outcome.complaints.append(f"safe {outcome.safe} SYNCs after the stop was told")
    for earlier, later in zip(rest, rest[1:], strict=False):
        for axis in healthy:
            outcome.moved += later[1][axis] is ENABLED and later[2][axis] != earlier[2][axis]
    if outcome.moved:
        outcome.complaints.append(f"{outcome.moved} targets after the stop")


def compare(rig: Rig, outcome: Outcome, shelf: Shelf, base: int) -> None:
    """Every recorded word against what the drive had shown at that SYNC or the one before."""
    answers = rig.seen.answers
    for visit in shelf.visits:
        if not visit.complete:
            continue
        for row, index in enumerate(visit.sync_index):
            for axis in range(6):
                word = (int(visit.position_count[row, axis]), int(visit.torque_word[row, axis]))
                shown = [answers.get((base + int(index) - back, axis + 1)) for back in (0, 1)]
                outcome.recorded += 1
                outcome.wrong += word not in shown
    if outcome.wrong:
        outcome.complaints.append(f"{outcome.wrong} wrong values in finished visits")


def timed(rig: Rig, kind: str, seed: int) -> tuple[Outcome, float]:
    """`play`, and how long it took [s]."""
    begin_s = time.monotonic()
    return play(rig, kind, seed), time.monotonic() - begin_s
