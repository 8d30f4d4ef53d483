"""Open benchmark of loads: its cells, the body of linear parameters, the scorer, and the methods on exact torques."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.loads.cells import drawn_in_motion, write_moving_cells, write_rest_cells
from benchmarks.loads.gateway_estimate import identify
from benchmarks.loads.methods import METHODS, answers_file, memory_file
from benchmarks.loads.score import GAIN_ROW, scores
from benchmarks.moving.cells import PERIODS, MovingCell
from benchmarks.moving.scores import load_truth
from benchmarks.naming.answers import Answer, read_answers
from benchmarks.naming.cells import TRUTH, read_cells, write_place
from benchmarks.naming.score import read_truth
from gateway.data.table import Table, write_csv
from sim.engine import Engine
from tests.support.rigs.tables import make_table

SEED = 70_000
STEP_S = 0.01
ROOT = Path(__file__).parents[3]
#: Package that a peer needs.
NEEDS = {"FIGAROH": "figaroh", "MuJoCo sysid": "mujoco"}


@pytest.fixture(scope="module")
def drawn() -> MovingCell:
    return drawn_in_motion(SEED)


def _exact(cell: MovingCell, moving: bool) -> Table:
    """Rows of rigid bodies alone: no friction, no noise, torque constants without error."""
    if moving:
        q, qd, qdd = (
            np.tile(part, (PERIODS, 1)) for part in cell.motion.states(np.arange(0.0, cell.motion.period_s, STEP_S))[:3]
        )
    else:
        q = np.random.default_rng(3).uniform(-1.5, 1.5, (12, 6))
        qd = qdd = np.zeros_like(q)
    parts = []
    for label in cell.start_s:
        with Engine([cell.arm.carrying(label)], cell.arm.gravity_m_s2) as dynamics:
            parts.append((label, dynamics.torque_nm(q, qd, qdd)))
    loads = np.repeat([label for label, _ in parts], len(q))
    torque = np.vstack([tau for _, tau in parts])
    q, qd, qdd = (np.tile(part, (2, 1)) for part in (q, qd, qdd))
    times = STEP_S * np.arange(len(loads))
    if moving:
        return make_table(loads, np.full(len(loads), -1), q, torque, run=loads, time=times, qd=qd, qdd=qdd)
    poses = np.tile(np.arange(len(q) // 2), 2)
    tables = {name: np.repeat(values, 2, axis=0) for name, values in {"q": q, "tau": torque}.items()}
    sides = np.tile([1, -1], len(loads))
    return make_table(
        np.repeat(loads, 2), np.repeat(poses, 2), tables["q"], tables["tau"], run=["r"] * 2 * len(loads),
        time=np.arange(2.0 * len(loads)), direction=sides, std=0.01,
    )  # fmt: skip


def _answer(drawn: MovingCell, moving: bool, method: str, tmp_path: Path) -> Answer:
    folder = tmp_path / ("motion" if moving else "rest")
    place = folder / "cells" / "cell0000"
    write_place(place, replace(drawn.stated, efficiency=np.ones(6)), None)
    write_csv(_exact(drawn, moving), place / "table.csv")
    words = [sys.executable, "-m", "benchmarks.loads", "--answer", method, str(folder)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert 20.0 < json.loads(memory_file(folder, method).read_text(encoding="utf-8")) < 4000.0
    return read_answers(answers_file(folder, method))["cell0000"]


def test_moving_cell_is_read_as_drawn_and_holds_no_truth(drawn: MovingCell, tmp_path: Path) -> None:
    write_moving_cells([SEED], tmp_path)
    (cell,) = read_cells(tmp_path / "cells")
    assert cell.urdf == drawn.stated.urdf
    assert cell.gain_std == pytest.approx(drawn.gain_std)
    table = drawn.table()
    np.testing.assert_allclose(cell.table.tau_nm, table.tau_nm, atol=1e-6)
    assert cell.table.moving.all()
    written = {path.name for path in (tmp_path / "cells").rglob("*") if path.is_file()}
    assert written == {"robot.urdf", "table.csv", "statements.json"}
    truth = read_truth(tmp_path / "truth")["cell0000"]
    assert truth["load"] == pytest.approx(load_truth(drawn.arm.tool))
    assert truth["axes"]["gain"] == pytest.approx(drawn.arm.gain)


def test_rest_cells_have_no_effect_and_the_gateway_finds_their_load(tmp_path: Path) -> None:
    write_rest_cells([SEED], tmp_path)
    entry = json.loads((tmp_path / "truth" / TRUTH).read_text(encoding="utf-8"))
    assert entry["effects"] == []
    (cell,) = read_cells(tmp_path / "cells")
    found = identify(cell, moving=False)
    assert found.load is not None
    assert found.load[0] == pytest.approx(entry["load"][0], rel=0.05)
    assert len(found.load) == 4


def test_scorer_counts_errors_coverage_and_missing_loads_by_hand() -> None:
    load = [10.0, 0.1, 0.0, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0]
    axes = {
        "coulomb_nm": [10.0, 20.0],
        "viscous_nm_s_rad": [1.0, 1.0],
        "rotor_inertia_kg_m2": [2.0, 2.0],
        "gain": [0.0, 0.01],
    }
    truth = {cell: {"load": load, "axes": axes} for cell in "abc"}
    std = (0.2, *[0.01] * 3, *[0.02] * 6)
    first = (10.1, 0.1, 0.003, 0.204, 0.35, 0.4, 0.5, 0.0, 0.0, 0.0)
    second = (11.0, 0.1, 0.0, 0.2)
    answers = {
        "a": Answer("a", (), False, first, std, 1.0, {"coulomb_nm": (11.0, float("nan")), "gain": (0.005, 0.01)}),
        "b": Answer("b", (), False, second, std[:4], 3.0),
        "c": Answer("c", (), False, None, None, 2.0),
    }
    found = scores(truth, answers, 123.4)
    assert found["cells without a load"] == "1 of 3"
    assert found["mass: median error"] == "5.5 %"  # 1 and 10 %
    assert found["mass: rms error"] == "7.11 %"
    assert found["centre of gravity: median error"] == "2.5 mm"  # 5 and 0 mm
    assert found["95 % intervals that hold: mass"] == "50 % of 2"  # the mass of b is 5 standard deviations off
    assert found["95 % intervals that hold: centre"] == "100 % of 6"
    assert found["inertia: median error"] == "10 % of 1"  # 0.05 of 0.5
    assert found["95 % intervals that hold: inertia"] == "83 % of 6"
    assert found["Coulomb friction: median error"] == "10 % of 1"
    assert found["viscous friction: median error"] == "-"
    assert found[GAIN_ROW] == "0.25 % of 2"
    assert found["processor time per cell, median"] == "2 s"
    assert found["peak memory of the process"] == "123 MiB"


@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True], ids=["rest", "motion"])
@pytest.mark.parametrize("method", list(METHODS))
def test_method_finds_the_load_of_exact_torques(drawn: MovingCell, method: str, moving: bool, tmp_path: Path) -> None:
    package = NEEDS.get(method)
    if package is not None and importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install -c constraints.txt -e '.[loads]'")
    answer, truth = _answer(drawn, moving, method, tmp_path), load_truth(drawn.arm.tool)
    assert answer.load is not None
    assert answer.load[0] == pytest.approx(truth[0], rel=0.003)
    np.testing.assert_allclose(answer.load[1:4], truth[1:4], atol=0.001)
    if moving:
        np.testing.assert_allclose(answer.load[4:], truth[4:], atol=0.02 * truth[4:7].max())
