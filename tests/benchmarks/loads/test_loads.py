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

from benchmarks.loads.bodies import body_of, identified
from benchmarks.loads.cells import drawn_in_motion, write_moving_cells, write_rest_cells
from benchmarks.loads.gateway_estimate import identify
from benchmarks.loads.methods import METHODS, answers_file, memory_file
from benchmarks.loads.runs import runs_of, thinned
from benchmarks.loads.score import GAIN_ROW, scores
from benchmarks.moving.cells import PERIODS, MovingCell
from benchmarks.moving.scores import load_truth
from benchmarks.naming.answers import Answer, read_answers, write_answers
from benchmarks.naming.cells import TRUTH, read_cells, write_place
from benchmarks.naming.score import read_truth
from gateway.data.table import Table, write_csv
from sim.inverse import InverseDynamics
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
        with InverseDynamics(cell.arm.carrying(label), cell.arm.gravity_m_s2) as dynamics:
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


def test_rest_runs_are_half_sums_and_moving_runs_are_thinned_by_period(drawn: MovingCell, tmp_path: Path) -> None:
    write_rest_cells([SEED], tmp_path / "rest")
    (cell,) = read_cells(tmp_path / "rest" / "cells")
    runs = runs_of(cell, moving=False)
    assert [len(run.q) for run in runs.values()] == [int((cell.table.load == label).sum()) // 2 for label in runs]
    write_moving_cells([SEED], tmp_path / "motion")
    (cell,) = read_cells(tmp_path / "motion" / "cells")
    run = runs_of(cell, moving=True)["tool"]
    few, count = thinned(run), drawn.motion.samples
    assert len(few.tau) == count // 4
    np.testing.assert_allclose(few.tau[1], run.tau[4::count].mean(axis=0))


def test_body_of_linear_parameters_is_a_point_mass_and_a_rod() -> None:
    # rod of 2 kg along x from 0 to 0.6 m: inertia about its end m l^2 / 3, about its centre m l^2 / 12
    end, own = 2.0 * 0.36 / 3.0, 2.0 * 0.36 / 12.0
    linear = np.array([2.0, 0.6, 0.0, 0.0, 0.0, 0.0, end, 0.0, 0.0, end])
    np.testing.assert_allclose(body_of(linear), [2.0, 0.3, 0.0, 0.0, 0.0, own, own, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(body_of(linear[:4]), [2.0, 0.3, 0.0, 0.0])


def test_standard_deviations_are_propagated_to_the_centre() -> None:
    # x = h / m: with h exact, std(x) = x std(m) / m; y has the std of h over m
    found = identified(np.array([2.0, 0.6, 0.0, 0.0]), np.diag([0.02, 1e-12, 0.01, 1e-12]) ** 2, {})
    assert found.load_std == pytest.approx((0.02, 0.003, 0.005, 0.0), abs=1e-6)


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


def test_answers_with_axes_are_read_as_written(tmp_path: Path) -> None:
    answer = Answer("a", (), False, (1.0,) * 10, (0.1,) * 10, 1.0, {"gain": (0.1, 0.2)})
    write_answers([answer], tmp_path / "a.jsonl")
    assert read_answers(tmp_path / "a.jsonl") == {"a": answer}


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
