"""One fault at a random instant of a short run, and whether it ends as stated.

The run is the real one (pre-flight check, plan, stream, watch, drive group), in lockstep or in real time; what the
drives did is seen from their own side.
"""

from __future__ import annotations

import errno
import random
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np

from benchmarks.chaos.evidence import Evidence, Outcome, counters_of
from benchmarks.chaos.judging import compare, follow, held_up, judge
from benchmarks.chaos.remote import Remote
from benchmarks.chaos.rig import Rig, adapters
from drives.bus import BusSpec
from drives.errors import DriveError
from drives.realtime import RealTime
from gateway.acquire.events import Event, Started, StateChanged
from gateway.acquire.plan import Plan, plan_poses
from gateway.acquire.planning import visit_settings
from gateway.acquire.run_loop import Run, rest_visits
from gateway.acquire.visit_store import MemoryStore
from gateway.check.brakes import try_brakes
from gateway.check.moves import check_moves
from gateway.check.stop import prove_stop
from gateway.data.visit import RestPose
from gateway.errors import GatewayError
from gateway.motion.opening import OpenArm, open_arm
from gateway.motion.state import Phase
from gateway.motion.stream import MoveOptions
from sim.fault import Fault
from sim.faults import KINDS, fault_of

#: Of the small cell.
BUS = "a"
#: How often a scenario is begun again where the machine holds the master up.
TRIES = 4

#: Whom a fault may concern; only an axis that carries weight sinks.
NODES, CARRYING, SINKING = (1, 2, 3, 4, 5, 6), (3, 5), ("brake_slips", "brake_falls", "slow_brake")
#: Rest poses in lockstep; a lost heartbeat also takes real time, which a fast computer outruns in two poses.
LOCKSTEP_POSES, LOCKSTEP_POSES_LONG = 2, 8
BY_THE_CLOCK_TOO = frozenset({"heartbeat_lost", "heartbeat_back"})
#: Beginning of a fault after the start of the run, or of the phase that it is meant for [s].
EARLY_S, TAKEN_OVER_S, ANY_S, SAMPLES_S = (0.05, 0.2), (0.35, 1.5), (0.05, 1.5), (0.0, 0.08)
#: Of a visit: its approach, samples, and the longest wait for rest [s].
APPROACH_RAD, SAMPLES, SETTLE_S = 0.02, 25, 4.0
#: Nothing is wrong with drives of these kinds: they are configured and moved.
STRICT = (
    "strict_inhibit",
    "start_refused",
    "cycle_period_set",
    "no_data_abort",
    "tpdo3_on",
    "foreign_emcy_id",
)
#: Reactions of kinds that are played elsewhere: those that the drives have to stop by themselves or that need a process
#: of their own (`benchmarks.chaos.killing`), and those of the test of drives (`benchmarks.certify.drive_test`).
ELSEWHERE = frozenset({"drives stop", "kept", "drive test"})


def kinds() -> list[str]:
    """Kinds that are carried out here."""
    return [kind for kind, about in KINDS.items() if about.reaction not in ELSEWHERE]


def scenario(kind: str, node: int, seed: int) -> Fault:
    """Return the fault of a kind with its defaults, of one node where it is not one of the whole bus."""
    return fault_of(kind, node=0 if "node" in KINDS[kind].defaults else node, seed=seed)


def short_plan(opened: OpenArm, seed: int, lockstep_poses: int = LOCKSTEP_POSES) -> Plan:
    """One rest pose in real time, more in lockstep, from both sides; every joint travels to the first."""
    rng = random.Random(seed)
    config, workspace = opened.config, opened.workspace
    first = tuple(-float(np.sign(angle) or 1.0) * rng.uniform(0.25, 0.35) for angle in opened.arm.where())
    poses = [RestPose(1, first, "fit")]
    if opened.group.timing.pacing == "lockstep":
        half = tuple(0.5 * angle for angle in first)
        poses += [RestPose(n, first if n % 2 else half, "fit") for n in range(2, lockstep_poses + 1)]
    settings = replace(
        visit_settings(opened.loaded, config),
        approach_offset_rad=APPROACH_RAD,
        samples=SAMPLES,
        settle_timeout_s=SETTLE_S,
    )
    return plan_poses(config.name, workspace, poses, settings)[0]


class Beginning:
    """Lets the fault begin at an instant of the run that is drawn from the seed.

    Attributes
    ----------
    start : SYNC before the one at which it begins; 0 = from the start, or not yet
    in_samples : it is meant for the samples of a visit
    """

    def __init__(self, rig: Rig | Remote, kind: str, seed: int, fault: Fault | None) -> None:
        bus = rig.loaded.cell.bus[BUS]
        self._period_s = bus.sync_period_s
        self._rig, self._fault = rig, fault
        self._rng = random.Random(f"{kind} {seed}")
        self._moves = 0
        self.start = 0
        self._starts = KINDS[kind].starts
        self.in_samples = KINDS[kind].reaction == "retried" and kind != "tpdo_random_loss" and seed % 2 == 1
        self.from_start = self._starts in ("power-up", "between runs")

    def receive(self, event: Event) -> None:
        """Take an event of the run."""
        if self.start or self.from_start or self._starts == "in brakes":
            return
        phase = event.state.phase if isinstance(event, StateChanged) else None
        self._moves += phase is Phase.MOVING
        if self.in_samples:
            self._begin_if(phase is Phase.SAMPLING, SAMPLES_S)
        elif self._starts == "slow motion":  # between the two sides of a pose: not mistaken for an axis that is behind
            self._begin_if(phase is Phase.MOVING and self._moves == 2, EARLY_S)
        elif self._starts == "in motion":
            self._begin_if(phase is Phase.MOVING, EARLY_S)
        else:
            self._begin_if(isinstance(event, Started), TAKEN_OVER_S if self._starts == "load taken over" else ANY_S)

    def _begin_if(self, now: bool, span_s: tuple[float, float]) -> None:
        if now:
            offset = 1 + round(self._rng.uniform(*span_s) / self._period_s)
            self.start = self._rig.sync() + offset
            if self._fault is not None:
                self._rig.arm_in(self._fault, offset)


def play(rig: Rig | Remote, kind: str, seed: int) -> Outcome:
    """One fault at an instant drawn from the seed, in the pacing of the rig.

    Parameters
    ----------
    rig : Rig or Remote
        Simulated drives that run; they are as after power-up when this returns.
    kind : str
        One of `kinds()`.
    seed : int
    """
    rig.renew()
    bus = rig.loaded.cell.bus[BUS]
    outcome, evidence = Outcome(kind, seed, bus.pacing, bus.sync_period_s), Evidence()
    fault = None
    if KINDS[kind].where != "master":
        node = random.Random(f"node {kind} {seed}").choice(CARRYING if kind in SINKING else NODES)
        fault = scenario(kind, node, seed)
    begin = Beginning(rig, kind, seed, fault)
    outcome.in_samples = begin.in_samples
    base, error, limits = 0, None, rig.watched().torque_limits
    made: list[Any] = []
    with ExitStack() as stack:
        spec, ledger = BusSpec.parse(rig.bus), None
        if KINDS[kind].starts == "between runs":
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="ledger-"))
            ledger = Path(folder) / "ledger.json"
            with open_arm(rig.loaded, spec, ledger=ledger):
                pass
        if begin.from_start and fault is not None:
            rig.arm(fault)
            limits = rig.watched().torque_limits
        taken = adapters(lambda adapter: made.append(adapter) or adapter)
        try:
            with taken, open_arm(rig.loaded, spec, ledger=ledger) as opened:
                base = rig.sync()
                if kind == "queue_full":
                    fill_queue(made[0], random.Random(outcome.seed))
                if KINDS[kind].starts == "in brakes" and fault is not None:
                    rig.arm(fault)
                try:
                    _act(rig, opened, outcome, evidence, begin)
                finally:
                    evidence.counters = counters_of(opened, 0 if fault is None else fault.node)
        except (DriveError, GatewayError) as problem:
            error = problem
    watched = rig.watched()
    rig.renew()
    outcome.error = outcome.error or str(error or "")
    evidence.touched = watched.touched.get(kind, 0)
    raised = sum(now > own for own, now in zip(limits, watched.torque_limits, strict=True))
    evidence.counters = {**evidence.counters, "tpdo3 on": watched.tpdo3_on, "torque limits raised": raised}
    judge(watched, outcome, fault, error, evidence)
    follow(watched, outcome, fault, begin.start)
    compare(watched, outcome, evidence, base)
    outcome.held_up = held_up(watched, bus.sync_period_s, bus.pacing)
    return outcome


def play_again(rig: Rig | Remote, kind: str, seed: int) -> Outcome:
    """`play`, again where it did not end as stated and the machine that this runs on did not keep its time."""
    real = rig.loaded.cell.bus[BUS].pacing == "real"
    for tries in range(1, TRIES + 1):
        with RealTime() if real else nullcontext():
            outcome = play(rig, kind, seed)
        outcome.tries = tries
        if outcome.fine or not outcome.held_up:
            break
    return outcome


def _act(rig: Rig | Remote, opened: OpenArm, outcome: Outcome, evidence: Evidence, begin: Beginning) -> None:
    """Do with an open arm what the kind is about: a check, or a run."""
    kind = outcome.kind
    if kind in LOOKS:
        outcome.error = LOOKS[kind](opened)
        return
    store = MemoryStore()
    evidence.visits = store.visits
    listeners = (evidence.receive, begin.receive, lambda event: _say(rig, kind, event))
    run = Run(opened.arm, opened.workspace, store, listeners, pacing=opened.group.timing.pacing)
    plan = short_plan(opened, outcome.seed, LOCKSTEP_POSES_LONG if kind in BY_THE_CLOCK_TOO else LOCKSTEP_POSES)
    evidence.planned = len(plan.visits)
    try:
        run.execute(rest_visits(plan, opened.arm, opened.workspace), "none")
    finally:
        if kind == "brake_slips":
            outcome.error = next((reason for reason in evidence.reasons if reason), "")


def _say(rig: Rig | Remote, kind: str, event: Event) -> None:
    """A drive whose emergencies come from another id says that all is well: that has to be detected."""
    if kind == "foreign_emcy_id" and isinstance(event, Started):
        rig.all_well()


def _failing(items: Iterable[Any]) -> str:
    """The first failing item in words."""
    return next((f"{item.where}: {item.what}; {item.advice}" for item in items if item.severity == "fail"), "")


#: What shows a kind that no run shows: the proof of the stop, or small moves.
LOOKS: dict[str, Callable[[OpenArm], str]] = {
    "heartbeat_ignored": lambda opened: _failing(prove_stop(opened).items),
    "brake_falls": lambda opened: _failing(try_brakes(opened, MoveOptions())),
    "slow_brake": lambda opened: _failing(try_brakes(opened, MoveOptions())),
    "demand_torque": lambda opened: _failing(check_moves(opened)),
    "unsigned_torque": lambda opened: _failing(check_moves(opened)),
}


def fill_queue(adapter: Any, rng: random.Random) -> None:
    """Let an adapter refuse a frame now and then, as a full transmit queue does."""
    send = adapter.send

    def refuse(frame: can.Message, timeout: float | None = None) -> None:
        if rng.random() < 0.002:
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        send(frame, timeout)

    adapter.send = refuse
