"""Whether a scenario has ended as stated: reaction, cause, who is named, what was counted, what the drives did."""

from __future__ import annotations

import re

from benchmarks.chaos.evidence import Evidence, Outcome
from benchmarks.chaos.rig import Watched
from benchmarks.chaos.stated import SDO_REQUEST, STATED, Stated
from drives.errors import BrakeDropped, DriveError, SeveralFailures
from gateway.errors import LimitExceeded, PoseNeverSettles
from gateway.motion.reactions import REACTIONS
from sim.fault import Fault
from sim.faults import KINDS
from sim.states import PdsState

#: SYNCs from the first word of a stop to the last axis that is no longer enabled.
SAFE_BOUND = 5
#: In real time: a SYNC, or an answer, that is delayed by this share of a period is not on time.
DELAYED_SHARE = 0.5
#: In lockstep the master waits less long than this for a drive once others have answered [s].
LOCKSTEP_S = 0.3
ENABLED_WORD = 0x000F
ENABLED = PdsState.OPERATION_ENABLED


def judge(watched: Watched, outcome: Outcome, fault: Fault | None, error: Exception | None, evidence: Evidence) -> None:
    """The stated reaction, cause and counters against what happened."""
    reaction = KINDS[outcome.kind].reaction
    stated = STATED[outcome.kind]
    complain = outcome.complaints.append
    if fault is not None and not evidence.touched:
        complain("the fault touched nothing")
    if reaction in ("goes on", "retried"):
        if error is not None:
            complain(f"the run ended: {type(error).__name__}: {error}")
        else:
            judge_counts(outcome, stated, evidence)
            judge_samples(outcome, fault, evidence)
    else:
        judge_cause(outcome, stated, fault, error)
    if reaction == "refuses" and any(ENABLED in states for _, states, _, _ in watched.seen.states):
        complain("an axis was enabled")
    if any(state is ENABLED and not mute for state, mute in zip(watched.states, watched.unresponsive, strict=True)):
        complain("an axis is still enabled at the end")


def judge_cause(outcome: Outcome, stated: Stated, fault: Fault | None, error: Exception | None) -> None:
    """Return class, text, remedy and node of what is reported to the engineer."""
    said, complain = outcome.error, outcome.complaints.append
    if not said:
        complain("nothing was said")
        return
    causes = _causes(error)
    if stated.error is None and error is not None:
        complain(f"{type(error).__name__} was raised instead of a finding: {said}")
    if stated.error is not None and [type(each) for each in causes] != [stated.error]:
        found = ", ".join(type(each).__name__ for each in causes) or "nothing"
        complain(f"{stated.error.__name__} is stated, {found} was raised: {said}")
    first = said.partition("; while stopping")[0]
    if not re.search(stated.says, first, re.DOTALL):
        complain(f"it does not say '{stated.says}': {said}")
    if stated.rule and REACTIONS[stated.rule].advice not in first:
        complain(f"the remedy is not that of '{stated.rule}': {said}")
    if fault is not None and fault.node and not _names(stated, fault.node, causes, first):
        complain(f"node {fault.node} is not named: {said}")


def _causes(error: Exception | None) -> list[Exception]:
    """Single failures, in order."""
    if isinstance(error, SeveralFailures):
        return [each for failure in error.failures for each in _causes(failure)]
    return [] if error is None else [error]


def _names(stated: Stated, node: int, causes: list[Exception], said: str) -> bool:
    """Whether the node is named, in words and, by an error that has a place for it, by number."""
    if stated.named == "no node":
        return all(not isinstance(each, DriveError) or each.node is None for each in causes)
    if stated.named == "id":
        return f"id {SDO_REQUEST + node:03X}" in said
    drives = [each for each in causes if isinstance(each, DriveError) and not isinstance(each, BrakeDropped)]
    numbers = [each.node for each in drives]
    numbers += [each.joint for each in causes if isinstance(each, LimitExceeded | PoseNeverSettles)]
    word = "joint" if stated.named == "joint" else "node"
    others = {int(number) for number in re.findall(rf"\b{word} (\d)\b", said)}
    return others == {node} and all(number == node for number in numbers)


def judge_counts(outcome: Outcome, stated: Stated, evidence: Evidence) -> None:
    """Counters that have to show the fault, and those that may not."""
    for count in stated.counts_in(outcome.pacing):
        value = outcome.counted[count.name] = evidence.counters[count.name]
        least = max(count.least, count.share * evidence.touched)
        if value < least:
            outcome.complaints.append(f"'{count.name}' counts {value:g}, at least {least:g} are stated")
        if count.most is not None and value > count.most:
            outcome.complaints.append(f"'{count.name}' counts {value:g}, at most {count.most:g} are stated")


def judge_samples(outcome: Outcome, fault: Fault | None, evidence: Evidence) -> None:
    """Every visit is there and whole; what was repeated was reported, and is kept with the visit."""
    complain = outcome.complaints.append
    visits = [visit for visit in evidence.visits if visit.complete]
    if len(visits) != evidence.planned:
        complain(f"{len(visits)} visits of {evidence.planned}")
    kept, reported = sum(visit.incomplete_epochs for visit in visits), len(evidence.repeated)
    if kept != reported:
        complain(f"{reported} SYNCs were reported as repeated, {kept} are kept with the visits")
    if reported > evidence.counters["incomplete"]:
        complain(f"{reported} SYNCs were reported as repeated, {evidence.counters['incomplete']:g} are counted")
    reaction = KINDS[outcome.kind].reaction
    if reaction == "retried" and outcome.in_samples:
        named = {axis for event in evidence.repeated for axis in event.axes}
        wanted = {fault.node} if fault is not None and fault.node else named
        outcome.counted["taken again"] = reported
        if not reported or not wanted <= named or outcome.pacing == "lockstep" and named != wanted:
            complain(f"taken again: {reported}, of axes {sorted(named)}; the fault is about {sorted(wanted)}")


def follow(watched: Watched, outcome: Outcome, fault: Fault | None, start: int) -> None:
    """Detection, time to a safe state and targets after it, from the drives' side."""
    if KINDS[outcome.kind].reaction != "stops":
        return
    healthy = [axis for axis in range(6) if fault is None or fault.node != axis + 1]
    after = [each for each in watched.seen.states if each[0] > start and any(word == ENABLED_WORD for word in each[3])]
    last = next(iter(after), None)
    after = [each for each in watched.seen.states if last is not None and each[0] >= last[0]]
    stop = next((each for each in after if any(each[3][axis] != ENABLED_WORD for axis in healthy)), None)
    if stop is None:
        outcome.complaints.append("no drive was commanded to stop")
        return
    reported = stop[0] - 1
    bound = bound_syncs(outcome.kind, outcome.pacing, outcome.period_s)
    if start:
        outcome.detected = reported - start
        if bound is not None and outcome.detected > bound:
            outcome.complaints.append(f"reported after {outcome.detected} SYNCs, {bound} are stated")
    rest = [each for each in after if each[0] > reported]
    safe = next((each[0] for each in rest if all(each[1][axis] is not ENABLED for axis in healthy)), None)
    if safe is None:
        ended = not any(watched.states[axis] is ENABLED for axis in healthy)
        safe = watched.seen.states[-1][0] + 1 if ended else None
    if safe is None:
        outcome.complaints.append("an axis never left OPERATION ENABLED")
        return
    outcome.safe = safe - reported
    if outcome.safe > SAFE_BOUND:
        outcome.complaints.append(f"safe {outcome.safe} SYNCs after the stop was commanded")
    for earlier, later in zip(rest, rest[1:], strict=False):
        for axis in healthy:
            outcome.moved += later[1][axis] is ENABLED and later[2][axis] != earlier[2][axis]
    if outcome.moved:
        outcome.complaints.append(f"{outcome.moved} targets after the stop")


def bound_syncs(kind: str, pacing: str, period_s: float) -> int | None:
    """SYNCs from a fault to the first word of a stop; None = no such bound."""
    about = KINDS[kind]
    if pacing == "real" and about.bound_s is not None:
        return round(about.bound_s / period_s)
    return about.bound


def compare(watched: Watched, outcome: Outcome, evidence: Evidence, base: int) -> None:
    """Every recorded word against what the drive had sent in answer to that SYNC, and positions against targets."""
    answers = watched.seen.answers
    for sync, states, targets, _ in watched.seen.states:
        for axis, target in enumerate(targets):
            if states[axis] is ENABLED and (sync, axis + 1) in answers:
                outcome.behind = max(outcome.behind, abs(answers[sync, axis + 1][0] - target))
    for visit in evidence.visits:
        if not visit.complete:
            continue
        for row, index in enumerate(visit.sync_index):
            for axis in range(6):
                word = (int(visit.position_count[row, axis]), int(visit.torque_word[row, axis]))
                outcome.recorded += 1
                outcome.wrong += word != answers.get((base + int(index), axis + 1))
    if outcome.wrong:
        outcome.complaints.append(f"{outcome.wrong} values of another SYNC in finished visits")


def held_up(watched: Watched, period_s: float, pacing: str) -> bool:
    """Return whether the machine that this runs on did not let master or drives keep their time."""
    seen, limit_s = watched.seen, DELAYED_SHARE * period_s
    if pacing == "lockstep":
        return seen.slowest_s > LOCKSTEP_S
    rhythm = zip(seen.states, seen.came_s, seen.came_s[1:], strict=False)
    return seen.slowest_s > limit_s or any(
        later - earlier > period_s + limit_s for row, earlier, later in rhythm if set(row[3]) == {ENABLED_WORD}
    )
