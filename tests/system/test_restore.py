"""restore over the command line: from a copy of the cell, past a missing drive, and what is left named."""

from __future__ import annotations

import json
import shutil

import pytest


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
    done = gateway(*arguments, "--force")
    assert done.exit_code == 4, done.output
    assert torque(drives, 3) == before[2]
    assert gateway("restore", place.cell, "--bus", drives.bus, "--forget", "--yes").exit_code == 0
    done = gateway("restore", place.cell, "--bus", drives.bus)
    assert done.exit_code == 0, done.output
    assert "nothing to restore" in done.stdout
