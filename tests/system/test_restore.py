"""restore over the command line: from a copy of the cell, past a missing drive, and what is left named."""

from __future__ import annotations

import json
import math
import shutil

import pytest

from drives.values import DriveCommand
from gateway.jobs.cell_context import open_cell
from sim.states import PdsState


def configured(gateway, place, drives):
    """The drives hold what a motion has set."""
    done = gateway("move", place.cell, "--bus", drives.bus, "--to", "home", "--yes")
    assert done.exit_code == 0, done.output


def torque(drives, node):
    return drives.handle.simulation.arms[0].drives[node - 1].store.number((0x6072, 0))


@pytest.mark.slow
def test_what_a_run_has_written_is_restored_from_a_copy_of_the_cell_past_a_missing_and_an_exchanged_drive(
    gateway, serve, place, tmp_path
):
    drives = serve()
    before = [torque(drives, node) for node in range(1, 7)]
    configured(gateway, place, drives)
    assert [torque(drives, node) for node in range(1, 7)] != before
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in ("cell.toml", "robot.urdf"):
        shutil.copy(place.folder / name, elsewhere)
    simulated = drives.handle.simulation.arms[0].drives
    simulated[2].node.unpowered = True
    simulated[3].store.values[0x1018, 4] = 0x777777
    simulated[3].store.constant((0x1018, 4), "u32", 0x777777)
    out = tmp_path / "restored.json"
    arguments = ("restore", elsewhere / "cell.toml", "--bus", f"{drives.bus},hop_limit=0", "--json", out)
    done = gateway(*arguments)
    assert done.exit_code == 4, done.output
    assert "node 3" in done.stderr
    assert "remain in the write ledger" in done.stdout
    assert "to another device" in " ".join(done.stderr.split())
    (arm,) = json.loads(out.read_text())["arms"]
    assert {text.split(":")[0] for text in arm["left"]} == {"node 3", "node 4"}
    assert [torque(drives, node) for node in (1, 2, 5, 6)] == [before[node - 1] for node in (1, 2, 5, 6)]
    simulated[2].node.unpowered = False
    done = gateway(*arguments)
    assert done.exit_code == 4, done.output
    assert torque(drives, 3) == before[2]
    assert gateway("restore", place.cell, "--bus", drives.bus, "--forget", "--yes").exit_code == 0
    done = gateway("restore", place.cell, "--bus", drives.bus)
    assert done.exit_code == 0, done.output
    assert "nothing to restore" in done.stdout


def interrupt_motion(place, bus, pacing):
    """Enable the arm, move every motor at 2 rad/s, and send no other frame, as a killed master; return what is left."""
    context = open_cell(place.cell, bus, lambda _spec: None, pacing)
    (arm,) = context.arms
    opening = context.opened(arm)
    group = opening.__enter__().group
    group.enable()
    period_s = group.timing.period_s
    start_rad = [drive.target_count * drive.scale.count_rad for drive in group.drives]
    for sync in range(1, math.ceil(0.3 / period_s)):
        group.exchange([DriveCommand(position_rad + 2.0 * period_s * sync) for position_rad in start_rad])
    group.bus.close()
    return opening


@pytest.mark.slow
@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_drives_that_an_interrupted_run_left_energised_are_reported_and_disabled_at_rest(
    gateway, serve, place, monkeypatch, pacing
):
    """Speeds are those of the simulated axes at the transition out of the energised states."""
    drives = serve(pacing=pacing)
    simulated = drives.handle.simulation.arms[0].drives
    speeds_rad_s = {}

    def watch(drive):
        changed = drive.motion.state_changed

        def state_changed(before):
            if before in (PdsState.OPERATION_ENABLED, PdsState.QUICK_STOP_ACTIVE) and not drive.automaton.energised:
                speeds_rad_s[drive.node_id] = abs(drive.axis.omega_rad_s)
            changed(before)

        drive.motion.state_changed = state_changed

    for drive in simulated:
        drive.node.on_heartbeat_lost = lambda _node: None
        watch(drive)
    _interrupted = interrupt_motion(place, drives.bus, pacing)
    assert {drive.automaton.state for drive in simulated} == {PdsState.OPERATION_ENABLED}
    cell = (place.cell, "--bus", drives.bus)
    checked = gateway("check", *cell, "--pacing", pacing)
    assert checked.exit_code == 7
    assert "energised" in checked.output
    moved = gateway("move", *cell, "--pacing", pacing, "--to", "home", "--yes")
    assert moved.exit_code == 4
    assert "servo-gateway restore CELL" in " ".join(moved.stderr.split())
    restored = gateway("restore", *cell)
    assert restored.exit_code == 0, restored.output
    assert restored.stdout.count("was in OPERATION ENABLED") == 6
    assert {drive.automaton.state for drive in simulated} == {PdsState.SWITCH_ON_DISABLED}
    assert max(speeds_rad_s.values(), default=0.0) < 1e-3
    assert "energised" not in gateway("check", *cell, "--pacing", pacing).output
