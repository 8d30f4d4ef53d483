"""Evidence of one scenario: reports to the engineer, counters, and states of the drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from drives.statistics import GroupStatistics
from gateway.acquire.events import Event, SampleRepeated, StateChanged
from gateway.data.visit import Visit
from gateway.motion.opening import OpenArm


@dataclass(slots=True)
class Outcome:
    """What came of one fault.

    Attributes
    ----------
    kind, seed, pacing, period_s : which
    complaints : what was not as stated; empty = ended in its stated reaction, for its stated cause, counted as stated
    detected, safe : SYNCs from the fault to the first word of a stop, and from there to the last axis out of operation
    moved : axes and SYNCs at which an enabled axis was given a new target after that first word
    behind : farthest that an enabled axis was from its last target [counts]
    recorded, wrong : values in finished visits; of them those that the drive had not sent in answer to that SYNC
    in_samples : the fault was meant for the samples of a visit
    counted : counters that were asked for, as found
    error : what is reported to the engineer
    held_up : the machine that this runs on did not keep its time, which may be what was complained of
    tries : how often it was begun
    """

    kind: str
    seed: int
    pacing: str
    period_s: float
    complaints: list[str] = field(default_factory=list)
    detected: int | None = None
    safe: int | None = None
    moved: int = 0
    behind: int = 0
    wrong: int = 0
    recorded: int = 0
    in_samples: bool = False
    counted: dict[str, float] = field(default_factory=dict)
    error: str = ""
    held_up: bool = False
    tries: int = 1

    @property
    def fine(self) -> bool:
        """Whether it ended as stated."""
        return not self.complaints


@dataclass(slots=True)
class Evidence:
    """Gathered while a scenario runs.

    Attributes
    ----------
    visits : as they were kept
    planned : visits that the plan asks for
    repeated : SYNCs while sampling that were taken again
    reasons : of the states that the arm went through
    counters : by name, once the run has ended
    touched : frames that the fault has touched
    """

    visits: list[Visit] = field(default_factory=list)
    planned: int = 0
    repeated: list[SampleRepeated] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    counters: Mapping[str, float] = field(default_factory=dict)
    touched: int = 0

    def receive(self, event: Event) -> None:
        """Take an event of the run."""
        if isinstance(event, SampleRepeated):
            self.repeated.append(event)
        elif isinstance(event, StateChanged):
            self.reasons.append(event.state.reason)


def counters_of(opened: OpenArm, node: int) -> dict[str, float]:
    """Every counter that a kind may ask for, about one node (0 = any)."""
    statistics = opened.group.statistics
    nodes = [node] if node else [config.node_id for config in opened.config.axis]
    return {
        "incomplete": statistics.incomplete,
        "delayed": statistics.late,
        "delayed or unsure": statistics.late + statistics.ambiguous + statistics.unsure,
        "duplicate": statistics.duplicate,
        "ambiguous": statistics.ambiguous,
        "wrong_length": statistics.wrong_length,
        "unsure": statistics.unsure,
        "overruns": statistics.overruns,
        "warnings": statistics.warnings,
        "error frames": statistics.frames.get("error", 0),
        "extended frames": statistics.frames.get("extended", 0),
        "remote frames": statistics.frames.get("remote", 0),
        "send retries": statistics.frames.get("send_retries", 0),
        **_emergencies(statistics, nodes),
        **_sdo(statistics, nodes),
        **_ledger(opened, nodes),
    }


def _emergencies(statistics: GroupStatistics, nodes: list[int]) -> dict[str, float]:
    own = [each for each in statistics.emcy if each.node_id in nodes]
    return {
        "emcy": statistics.emcy_count,
        "emcy of the node": len(own),
        "emcy of an error": sum(not each.is_harmless for each in own),
    }


def _sdo(statistics: GroupStatistics, nodes: list[int]) -> dict[str, float]:
    own = [each for each in statistics.sdo if each.node_id in nodes]
    return {
        "sdo timeouts": sum(each.timeouts for each in own),
        "sdo delayed": sum(each.late for each in own),
        "sdo aborts": sum(each.aborts for each in own),
        "sdo longest ms": 1000.0 * max(each.max_s for each in own),
    }


def _ledger(opened: OpenArm, nodes: list[int]) -> dict[str, float]:
    """What was written and remembered."""
    entries = [entry for node in nodes for entry in opened.group.ledger.of_node(node)]
    return {f"ledger {index:04X}": sum(entry.index == index for entry in entries) for index in (0x1006, 0x1802)}
