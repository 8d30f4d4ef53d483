"""The proof that the drives of a cell stop on loss of the master, made once for all tests with an equal cell."""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import uuid
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.chaos.programs import undisturbed
from drives.files import read_sealed, write_sealed
from gateway.cli import main
from gateway.jobs.cell_context import open_cell
from sim.serve import running


def keep_proof_of_stop(cell: Path, bus: str, folders: pytest.TempPathFactory) -> None:
    """Store a proof for a cell file on a bus in the current state folder, with the remark that the arm has moved.

    The first test that asks for the proof makes it with `check --prove-stop` on simulated drives without faults. It is
    kept in the folder that the workers of one test run share, for all cells that differ in their poses alone. It is
    void where a drive differs from that.
    """
    run = folders.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # else the folder above is that of all runs, whose proofs may be void
        run = run.parent
    proven = re.sub(r"(?m)^loading_rad = .*\n", "", cell.read_text(encoding="utf-8").split("[poses]")[0])
    kept = run / f"proof-{hashlib.sha256(proven.encode()).hexdigest()[:16]}.json"
    with kept.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            kept.write_text(_proof(cell, folders.mktemp("proof")), encoding="utf-8")
    path = _stored_at(cell, bus)
    path.write_text(kept.read_text(encoding="utf-8"), encoding="utf-8")


def _stored_at(cell: Path, bus: str) -> Path:
    context = open_cell(cell, bus, lambda _spec: None)
    return context.stop_proof(context.loaded.cell.arm[0])


def _proof(cell: Path, state: Path) -> str:
    bus = f"virtual:proof-{uuid.uuid4().hex}"

    def check() -> tuple[int, str]:
        with running(cell, bus):
            done = CliRunner().invoke(main, ["check", str(cell), "--bus", bus, "--prove-stop", "--yes"])
        return done.exit_code, done.output

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(state))
        code, said = undisturbed(check)
        assert code == 0, said
        path = _stored_at(cell, bus)
        return write_sealed(path, read_sealed(path) | {"moved": True})
