"""Requests to stop, limits and contact are answered at every SYNC of the stop proofs; slaves on a wire, in lockstep."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest

from drives.errors import DriveFault
from gateway.check.proofs import prove_now, proven_on
from gateway.check.stop import SPEED_RAD_S, prove_stop
from gateway.errors import LimitExceeded
from gateway.motion.opening import OpenArm
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions
from tests.support.rigs.wired_arm import Joint, last_set_point, ramp_syncs, wired_arm

PERIOD_S = 0.02


@pytest.fixture
def rig(small_cell) -> Iterator[tuple[OpenArm, list[Joint]]]:
    with wired_arm(small_cell, PERIOD_S) as opened:
        yield opened


def asks_at(slaves: list[Joint], sync: int, kind: StopKind, asked: list[int]) -> StopDesk:
    """A desk with a person who wants a stop from a SYNC on."""

    def person() -> StopRequest | None:
        if slaves[0].sync_seen < sync:
            return None
        asked.append(slaves[0].sync_seen)
        return StopRequest(kind, StoppedByPerson("a person"))

    return StopDesk(person)


def phases_of(slave: Joint) -> dict[str, int]:
    """A SYNC in the middle of what goes on one after the other in an uninterrupted proof."""
    states, targets = slave.states, [target for _, target in slave.commands]

    def first(after: int, found: Callable[[int], bool]) -> int:
        return next(number for number in range(after, len(states)) if found(number))

    def moves(number: int) -> bool:
        return targets[number] != targets[number - 1]

    up = first(0, lambda number: states[number] == "operation enabled")
    moving = first(up, moves)
    left = first(moving, lambda number: states[number] != "operation enabled")
    beats = slave.last_beats[left]
    down = first(left, lambda number: states[number] == "switch on disabled")
    again = first(down, lambda number: states[number] == "operation enabled")
    moving_again = first(again, moves)
    quick = first(again, lambda number: slave.commands[number][0] == 0x02)
    down_again = first(quick, lambda number: states[number] == "switch on disabled")
    end = len(states)
    return {
        "bring-up": up // 2,
        "brakes open": (up + moving) // 2,
        "begin of the motion": moving + 1,
        "motion": (moving + beats) // 2,
        "last heartbeat": beats,
        "heartbeat withheld": (beats + left) // 2,
        "before the drives stop": left - 1,
        "drives stop": left,
        "after they have stopped": left + 3,
        "voltage disabled": down + 3,
        "second bring-up": again - 2,
        "second motion": (moving_again + quick) // 2,
        "quick stop": quick,
        "after the quick stop": (quick + down_again) // 2,
        "second disabling": (down_again + end) // 2,
    }


PHASES = (
    "bring-up",
    "brakes open",
    "begin of the motion",
    "motion",
    "last heartbeat",
    "heartbeat withheld",
    "before the drives stop",
    "drives stop",
    "after they have stopped",
    "voltage disabled",
    "second bring-up",
    "second motion",
    "quick stop",
    "after the quick stop",
    "second disabling",
)


@pytest.fixture(scope="module")
def phases(small_cell) -> dict[str, int]:
    with wired_arm(small_cell, PERIOD_S) as (opened, slaves):
        assert prove_stop(opened).passed
        found = phases_of(slaves[0])
    assert tuple(found) == PHASES
    return found


@pytest.mark.parametrize(
    ("kind", "phase"),
    [(StopKind.ALONG_PATH, phase) for phase in PHASES] + [(StopKind.QUICK_STOP, phase) for phase in PHASES[2::3]],
)
def test_a_request_at_any_sync_of_the_proof_is_answered_within_one_sync_and_the_ramp(rig, phases, phase, kind):
    (opened, slaves), sync = rig, phases[phase]
    asked: list[int] = []
    with pytest.raises(StoppedByPerson, match="a person"):
        prove_stop(opened, MoveOptions(asks_at(slaves, sync, kind, asked)))
    assert asked
    allowed = 1 + (ramp_syncs(opened.workspace, SPEED_RAD_S, PERIOD_S) if kind is StopKind.ALONG_PATH else 0)
    assert last_set_point(slaves) - sync <= allowed
    assert {slave.state for slave in slaves} == {"switch on disabled"}
    assert not opened.group.enabled


@pytest.mark.parametrize(("code", "left"), [(0x8130, "switch on disabled"), (0x7305, "fault")])
def test_a_fault_that_a_stopped_proof_has_provoked_is_reset_and_another_is_named(rig, phases, code, left):
    """Some drives answer the lost heartbeat with FAULT, whatever 0x6007 says."""
    opened, slaves = rig
    slave, asked = slaves[2], list[int]()
    slave.values[0x603F, 0] = code
    slave.without_master = dict.fromkeys(slave.without_master, "fault")
    desk = asks_at(slaves, phases["after they have stopped"], StopKind.ALONG_PATH, asked)
    with pytest.raises(StoppedByPerson, match="a person") as caught:
        prove_stop(opened, MoveOptions(desk))
    assert asked
    assert slave.state == left
    named = [note for note in caught.value.__notes__ if note.startswith("node 3: stays in FAULT")]
    assert bool(named) == (left == "fault")


@pytest.mark.parametrize(
    ("phase", "code"), [("bring-up", 0x8130), ("motion", 0x8130), ("last heartbeat", 0x8130), ("drives stop", 0x7305)]
)
def test_a_fault_that_no_lost_heartbeat_explains_stays(rig, phases, phase, code):
    """It is older than the proof, comes before the heartbeat is withheld, comes too early, or is of another class."""
    opened, slaves = rig
    for slave in slaves:
        slave.values[0x603F, 0] = code if slave is slaves[2] else 0x8130
        slave.without_master = dict.fromkeys(slave.without_master, "fault")
    slave = slaves[2]
    slave.state = "fault" if phase == "bring-up" else slave.state
    slave.at_sync = lambda: slave.sync_seen == phases[phase] + 3 and setattr(slave, "state", "fault")
    if phase in ("last heartbeat", "drives stop"):
        (finding,) = [item for item in prove_stop(opened).items if item.where == "J3 node 3"]
        assert f"stays in FAULT, error code 0x{code:X}" in finding.what
    else:
        with pytest.raises(DriveFault, match="node 3.*FAULT"):
            prove_stop(opened)
    assert [each.state for each in slaves].count("fault") == 1
    assert not any(word & 0x80 for word in slave.controlwords)


def test_a_proof_that_was_stopped_is_not_kept_as_proven(rig, phases, tmp_path, monkeypatch):
    opened, slaves = rig
    path, asked = tmp_path / "proof.json", []
    monkeypatch.setattr("gateway.check.proofs.fingerprint", lambda _opened: {"drives": 1})
    options = MoveOptions(asks_at(slaves, phases["quick stop"], StopKind.ALONG_PATH, asked))
    with pytest.raises(StoppedByPerson):
        prove_now(opened, path, lambda _text: None, options)
    assert asked
    assert proven_on(path, opened) is None
    prove_now(opened, path, lambda _text: None, MoveOptions())
    assert proven_on(path, opened)


@pytest.mark.parametrize(("phase", "joint"), [("motion", 2), ("heartbeat withheld", 2), ("heartbeat withheld", 3)])
def test_contact_and_a_joint_outside_its_range_stop_the_arm_in_a_proof(rig, phases, phase, joint):
    opened, slaves = rig
    slave = slaves[joint - 1]

    def changes() -> None:
        if slave.sync_seen >= phases[phase]:
            name, value = ("torque", 900) if joint == 2 else ("position", round(slave.joint_count * 3.5))
            setattr(slave, name, value)

    slave.at_sync = changes
    with pytest.raises(LimitExceeded, match=f"joint {joint}"):
        prove_stop(opened)
    assert last_set_point(slaves) <= phases[phase] + 6
    assert {each.state for each in slaves} == {"switch on disabled"}


def test_the_quick_stop_is_tried_while_the_arm_moves(rig, phases):
    """A stop that begins at rest proves nothing of the ramp."""
    opened, slaves = rig
    proof = prove_stop(opened)
    assert proof.passed
    for slave in slaves:
        quick = phases["quick stop"]
        assert (slave.commands[quick - 1][0], slave.commands[quick][0]) == (0x0F, 0x02)
        step = abs(slave.commands[quick - 1][1] - slave.commands[quick - 2][1]) / slave.joint_count
        assert step / PERIOD_S == pytest.approx(SPEED_RAD_S, rel=0.05)


@pytest.mark.parametrize("override", [1.0, 0.1])
def test_a_proof_obeys_the_override_and_is_valid_up_to_it(rig, tmp_path, monkeypatch, override):
    opened, slaves = rig
    path = tmp_path / "proof.json"
    monkeypatch.setattr("gateway.check.proofs.fingerprint", lambda _opened: {"drives": 1})
    prove_now(opened, path, lambda _text: None, MoveOptions(override=override))
    for slave in slaves:
        steps = [abs(new - old) for (word, old), (now, new) in pairwise(slave.commands) if word == now == 0x0F]
        fastest = max(steps) / slave.joint_count / PERIOD_S
        assert fastest == pytest.approx(override * SPEED_RAD_S, rel=0.1)
    assert proven_on(path, opened, override)
    assert proven_on(path, opened, 1.0) is None or override == 1.0


def test_a_drive_that_has_stopped_by_itself_is_no_contact(rig):
    """One gives up early: its torque vanishes and its setpoints go on without it."""
    opened, slaves = rig
    slaves[3].torque = 900

    def gives_up() -> None:
        slaves[3].torque = 200 if slaves[3].state == "operation enabled" else 0

    slaves[3].at_sync = gives_up
    arm = type(opened.group.drives[3]).arm

    def impatient(drive):
        arm(drive)
        slaves[3].values[0x1016, 1] = 127 << 16 | 250

    opened.group.drives[3].arm = impatient.__get__(opened.group.drives[3])  # type: ignore[method-assign]
    proof = prove_stop(opened)
    assert proof.traces[3].left_s == pytest.approx(0.26, abs=2 * PERIOD_S)
    assert np.all(np.array(proof.moved_rad)[[0, 1, 2]] > 0.02)
