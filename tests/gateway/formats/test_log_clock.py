"""Time stamps that scatter: the clock behind them, speeds on it, and the load that comes of such a log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.formats.smooth import clock_of, motion_of, rates
from tests.data.log_columns import COLUMNS
from tests.data.moving_arm import World, measured

STEP_S = 0.008
ROBOT = Path(__file__).parents[3] / "examples" / "small" / "robot.urdf"
LOAD = (3.2, 0.05, 0.02, 0.09)
MAP = f"""axes = 6
[load]
column = "load"
[time]
column = "t"
[motion]
cutoff_hz = 10
{COLUMNS}"""


def positions(time_s: np.ndarray) -> np.ndarray:
    """Positions (n, 2) of a known motion."""
    return np.column_stack([np.sin(1.3 * time_s + axis) + 0.3 * np.sin(4.1 * time_s + 2 * axis) for axis in range(2)])


def accelerations(time_s: np.ndarray) -> np.ndarray:
    return -np.column_stack(
        [1.3**2 * np.sin(1.3 * time_s + axis) + 0.3 * 4.1**2 * np.sin(4.1 * time_s + 2 * axis) for axis in range(2)]
    )


@pytest.mark.parametrize("scatter_s", [0.0, 0.0002, 0.0019])
@pytest.mark.parametrize("sampled", ["evenly", "at the stamps"])
def test_accelerations_from_stamps_that_scatter(scatter_s, sampled):
    rng = np.random.default_rng(7)
    even_s = np.arange(2500) * STEP_S
    stamp_s = even_s + rng.uniform(-scatter_s, scatter_s, len(even_s))
    true_s = stamp_s if sampled == "at the stamps" else even_s
    kept = np.sort(rng.choice(np.arange(1, 2499), 2480, replace=False))
    q_rad = positions(true_s) + rng.normal(0, 1e-5, (len(true_s), 2))
    motion = motion_of(stamp_s[kept], q_rad[kept], 8.0)
    inner = slice(100, -100)
    error = motion.qdd_rad_s2[inner] - accelerations(true_s[kept])[inner]
    assert np.sqrt((error**2).mean()) < 0.01
    assert motion.time_s == pytest.approx(true_s[kept], abs=3e-4 if scatter_s > 0.001 else 5e-5)
    if scatter_s:  # what filtering by rows and differences over the stamps gives
        naive = rates(stamp_s[kept], q_rad[kept], 8.0)[1][inner] - accelerations(true_s[kept])[inner]
        assert np.sqrt((naive**2).mean()) > 1.0


@pytest.mark.parametrize("scatter", [0.0, 0.1, 0.24])
def test_the_clock_is_found_with_its_lost_samples(scatter):
    rng = np.random.default_rng(3)
    index = np.delete(np.arange(20_000), np.unique(rng.integers(1, 19_999, 400)))
    stamp_s = 5.0 + 0.00801 * index + rng.uniform(-scatter, scatter, len(index)) * 0.00801
    clock = clock_of(stamp_s)
    assert np.array_equal(clock.index, index - index[0])
    assert clock.lost == 20_000 - len(index)
    assert clock.step_s == pytest.approx(0.00801, rel=1e-5)
    assert clock.jitter_s.std() == pytest.approx(scatter * 0.00801 / np.sqrt(3), rel=0.03, abs=1e-12)


def _import(folder: Path, time_s, q_rad, tau_nm, cutoff_hz: float = 10):
    """Import of a log with these times, positions and torques of load a."""
    rows = [["t", "load", *(f"{kind}{axis}" for kind in "qm" for axis in range(1, 7))]]
    rows += [[t, "a", *q, *tau] for t, q, tau in zip(time_s.tolist(), q_rad.tolist(), tau_nm.tolist(), strict=True)]
    (folder / "log.csv").write_text("\n".join(",".join(map(str, row)) for row in rows))
    (folder / "map.toml").write_text(MAP.replace("cutoff_hz = 10", f"cutoff_hz = {cutoff_hz}"))
    words = ["import", folder / "log.csv", "--map", folder / "map.toml", "-o", folder / "table.csv"]
    return CliRunner().invoke(main, list(map(str, words)))


def _imported(folder: Path, scatter_s: float, seed: int = 4) -> tuple[Path, str]:
    """Table of a run with the load, whose time stamps scatter, and what the import says."""
    rng = np.random.default_rng(seed)
    table = measured([seed, 1], World(payload=LOAD), 20.0, 1 / STEP_S, arm_seed=seed)[0]
    stamps = np.arange(len(table.time_s)) * STEP_S + rng.uniform(-scatter_s, scatter_s, len(table.time_s))
    done = _import(folder, stamps, table.q_rad, table.tau_nm)
    assert done.exit_code == 0, done.output
    return folder / "table.csv", " ".join(done.stderr.split())


def _load(folder: Path, scatter_s: float) -> tuple[np.ndarray, np.ndarray, str]:
    """Mass and centre, their standard deviations, and what the import says."""
    folder.mkdir()
    table, said = _imported(folder, scatter_s)
    words = ["estimate", table, "--robot", ROBOT, "--inertials", "prior:0.05", "--json", folder / "r.json"]
    done = CliRunner().invoke(main, list(map(str, words)))
    assert done.exit_code == 0, done.output
    (load,) = json.loads((folder / "r.json").read_text())["loads"]
    return np.array([load["mass_kg"], *load["com_m"]]), np.array([load["mass_std_kg"], *load["com_std_m"]]), said


@pytest.mark.slow
def test_the_load_from_a_log_whose_stamps_scatter(tmp_path):
    even, std, _ = _load(tmp_path / "even", 0.0)
    assert std[0] < 0.5
    assert (std[1:] < 0.03).all()
    for scatter_s in (0.0002, 0.0019):
        found, std, said = _load(tmp_path / str(scatter_s), scatter_s)
        assert f"stamps off by {1e3 * scatter_s / np.sqrt(3):.1g}" in said
        assert (np.abs(found - LOAD) < 2.5 * std).all(), (found, std)
        assert (np.abs(found - even) < 0.2 * std).all(), (found, even, std)


@pytest.mark.parametrize(
    ("kind", "code", "says"),
    [
        ("noise", 3, "Log at a fixed rate"),
        ("motion", 0, "the positions agree with the stamps"),
        ("recorded twice", 0, "800 rows"),
        ("in ms", 3, "correct the unit under [time]"),
        ("in ks", 3, "correct the unit under [time]"),
        ("without time", 3, "name another column under [time]"),
    ],
)
def test_uneven_stamps_are_used_where_the_positions_agree_with_them(tmp_path, kind, code, says):
    rng = np.random.default_rng(1)
    at_s = np.cumsum(rng.choice([0.010, 0.011, 0.012], 800))
    q_rad = rng.normal(0, 0.02, (800, 6)) if kind == "noise" else np.tile(positions(at_s), 3)
    factor = {"in ms": 1e3, "in ks": 1e-3, "without time": 0.0}.get(kind, 1.0)
    rows = np.repeat(np.arange(800), 1 + (kind == "recorded twice"))
    done = _import(tmp_path, factor * at_s[rows], q_rad[rows], np.ones((len(rows), 6)), 5)
    assert done.exit_code == code, done.output
    assert says in " ".join(done.output.split())
