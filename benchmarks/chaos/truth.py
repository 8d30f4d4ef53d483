"""A million answers over a wire that loses, repeats, delays, tears and shuffles: none that is taken may be wrong."""

from __future__ import annotations

import math
import random
import re
from dataclasses import dataclass

from benchmarks.chaos.rig import Rig, rig
from drives.bus import BusSpec, open_bus
from drives.drive import DriveCommand
from drives.group import DriveGroup, GroupOptions
from gateway.motion.opening import axis_setups
from sim.faults import fault_of

KINDS = (
    "tpdo_lost",
    "tpdo_late",
    "tpdo_duplicated",
    "tpdo_torn",
    "tpdo_delayed",
    "tpdo_short",
    "tpdo_empty",
    "tpdo_reordered",
    "sync_lost",
    "rpdo_lost",
)
#: SYNCs for each fault, and how many SYNCs back the answers are kept.
EVERY = 120
KEPT = 64
SWING_RAD = 2.0
GAP_S = 0.01
PERIOD_S = 0.002


@dataclass(slots=True)
class Verdict:
    """What came of many answers.

    Attributes
    ----------
    taken, stale, wrong : answers that were taken as good; of them the drive's answer to the SYNC before; neither
    incomplete, cycles, faults : SYNCs with a gap, SYNCs, faults on the wire
    """

    taken: int = 0
    stale: int = 0
    wrong: int = 0
    incomplete: int = 0
    cycles: int = 0
    faults: int = 0


def short_period(text: str) -> str:
    """Edit of a cell's text: little physics between two SYNCs."""
    return re.sub(r"sync_period_s = [\d.]+", f"sync_period_s = {PERIOD_S}", text)


def many(answers: int, seed: int = 1) -> Verdict:
    """Swing all axes and compare every answer that the drive group takes as good with what the drive had sent.

    Parameters
    ----------
    answers : int
        How many to compare.
    seed : int
        Of the faults.
    """
    verdict = Verdict()
    rng = random.Random(seed)
    with rig(short_period) as made:
        setups = axis_setups(made.loaded, made.loaded.cell.arm[0])
        # Whether values are true is the question here, not when the arm is stopped.
        options = GroupOptions(gap_timeout_s=GAP_S, answer_timeout_s=0.02, unanswered_syncs=10_000)
        with open_bus(BusSpec.parse(made.bus)) as bus, DriveGroup(bus, setups, PERIOD_S, options=options) as group:
            group.connect()
            group.configure()
            base = made.wire.sync
            start = [reading.position_rad for reading in group.enable().readings if reading is not None]
            while verdict.taken < answers:
                _stretch(made, group, base, start, rng, verdict)
    return verdict


def _stretch(made: Rig, group: DriveGroup, base: int, start: list[float], rng: random.Random, verdict: Verdict) -> None:
    """A few hundred SYNCs."""
    made.wire.clear()
    for number in range(5):
        kind = rng.choice(KINDS)
        node = 0 if kind in ("sync_lost", "tpdo_reordered") else rng.randint(1, 6)
        fault = fault_of(kind, node=node, syncs=rng.randint(1, 3), seed=rng.getrandbits(30))
        made.wire.arm_in(fault, number * EVERY + rng.randint(1, EVERY - 10))
        verdict.faults += 1
    for _ in range(5 * EVERY):
        phase = 2.0 * math.pi * verdict.cycles / 400.0
        swing = SWING_RAD * (1.0 - math.cos(phase))
        epoch = group.exchange([DriveCommand(angle + swing) for angle in start])
        verdict.cycles += 1
        verdict.incomplete += not epoch.complete
        sync = base + epoch.sync_index
        for axis, reading in enumerate(epoch.readings, start=1):
            if reading is None:
                continue
            answer = (reading.position_count, reading.torque_word)
            verdict.taken += 1
            if answer != made.seen.answers.get((sync, axis)):
                old = answer == made.seen.answers.get((sync - 1, axis))
                verdict.stale += old
                verdict.wrong += not old
    made.seen.states.clear()
    for key in [key for key in made.seen.answers if key[0] < made.wire.sync - KEPT]:
        made.seen.answers.pop(key, None)
