"""pair teach, run, learn and report: what they refuse, and what they do without a bus."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gateway.cli import main
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_store import PairStore
from gateway.pair.transform_function import function_of_knots, transform_of

#: Two commands may not use one bus at the same time, in whatever process.
pytestmark = pytest.mark.xdist_group("bus of the pair example")

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "pair"


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    folder = tmp_path / "pair"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("*.pair"))
    return folder / "cell.toml"


def call(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)


def taught(cell: Path) -> PairStore:
    """A store with a first function of two knots."""
    pair = load_pair(cell)
    store = PairStore(pair, cell.with_suffix(".pair"))
    path = pair.path()
    function = function_of_knots([0.0, path.length_m], np.stack([pair.nominal_relation] * 2))
    store.save("first", function, learn_source="taught", speed=0.0)
    return store


def edit(cell: Path, old: str, new: str, count: int = 1) -> None:
    text = cell.read_text(encoding="utf-8")
    assert old in text
    cell.write_text(text.replace(old, new, count), encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('master = "left"', 'master = "middle"', "middle"),
        ('master = "left"', 'master = "right"', "two arms on two buses"),
        ("knots = 9", "knots = 9\nknot_count = 3", "unknown key"),
        ("start_rad = ", "# start_rad = ", "start_rad"),
        ('path = "path.csv"', 'path = "nowhere.csv"', "nowhere.csv"),
    ],
)
def test_a_cell_that_cannot_be_a_pair_is_refused(cell: Path, old: str, new: str, said: str) -> None:
    edit(cell, old, new)
    result = call("pair", "teach", cell, "--yes")
    assert result.exit_code == 3
    assert said in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_constants_of_the_force_are_not_assumed(cell: Path) -> None:
    text = cell.read_text(encoding="utf-8")
    start = text.index("coulomb_nm")
    cell.write_text(text[:start] + text[text.index("\n", start) + 1 :], encoding="utf-8")
    result = call("pair", "teach", cell, "--yes")
    assert result.exit_code == 3
    assert "axis 1: coulomb_nm is missing" in result.output


@pytest.mark.parametrize(
    ("name", "words", "said"),
    [
        (EXAMPLE.parent / "small" / "cell.toml", (), "no [pair]"),
        ("cell.toml", (), "run teach"),
        ("cell.toml", ("--variant", "O"), "C8"),
    ],
    ids=["no pair", "not taught", "an embodiment that needs the truth"],
)
def test_a_run_that_cannot_be_is_refused(cell: Path, name: Path | str, words: tuple[str, ...], said: str) -> None:
    result = call("pair", "run", cell.parent / name, *words, "--yes")
    assert result.exit_code == 3
    assert said in result.output


def test_arms_away_from_the_start_are_refused_before_the_question(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    away = [arm.start_rad + 0.1 for arm in load_pair(cell).arms]
    link = SimpleNamespace(together=SimpleNamespace(where=lambda: away))
    monkeypatch.setattr("gateway.jobs.pair.open_link", lambda *_: nullcontext(link))
    result = call("pair", "teach", cell)
    assert result.exit_code == 5, result.output
    assert "the part is gripped at" in result.output
    assert "area clear" not in result.output


def test_a_changed_path_is_refused(cell: Path) -> None:
    taught(cell)
    path = cell.parent / "path.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    values = lines[100].split(",")
    values[1] = f"{float(values[1]) + 0.002:.6f}"
    path.write_text("\n".join([*lines[:100], ",".join(values), *lines[101:]]) + "\n", encoding="utf-8")
    result = call("pair", "run", cell, "--yes")
    assert result.exit_code == 3
    assert "another path" in result.output


def test_a_function_of_another_cell_is_refused(cell: Path) -> None:
    taught(cell)
    edit(cell, "tool_xyz_m = [0, 0, 0.15]", "tool_xyz_m = [0, 0, 0.16]")
    result = call("pair", "learn", "status", cell)
    assert result.exit_code == 3
    assert "another" in result.output


def swapped(body: dict) -> None:
    body["knots"].reverse()


def no_rotation(body: dict) -> None:
    body["knots"][0]["rotation"] = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]


@pytest.mark.parametrize(("harm", "said"), [(swapped, "out of order"), (no_rotation, "rotation")])
def test_a_damaged_function_is_refused(cell: Path, harm: Callable[[dict], None], said: str) -> None:
    store = taught(cell)
    path = store.folder / "first.json"
    body = json.loads(path.read_text(encoding="utf-8"))
    harm(body)
    path.write_text(json.dumps(body), encoding="utf-8")
    result = call("pair", "run", cell, "--yes")
    assert result.exit_code == 3
    assert said in result.output


def test_a_path_through_a_singular_posture_is_refused(cell: Path) -> None:
    taught(cell)
    lines = (cell.parent / "path.csv").read_text(encoding="utf-8").splitlines()
    moved = [lines[0]]
    for line in lines[1:]:
        values = [float(value) for value in line.split(",")]
        values[3] += 0.9
        moved.append(",".join(f"{value:.8f}" for value in values))
    (cell.parent / "path.csv").write_text("\n".join(moved) + "\n", encoding="utf-8")
    result = call("pair", "run", cell, "--variant", "A", "--yes")
    assert result.exit_code in (4, 5)


def test_learning_is_switched_off_on_and_forgotten(cell: Path) -> None:
    store = taught(cell)
    first = store.load("first")
    assert first is not None
    store.save("second", transform_of(first), learn_source="command", speed=1.5, embodiment="C8", cycles=3)
    assert call("pair", "learn", "freeze", cell).exit_code == 0
    assert store.frozen
    status = json.loads(CliRunner().invoke(main, ["pair", "learn", "status", str(cell), "--json", "-"]).stdout)
    assert status["learning"] == "off"
    assert status["functions"]["second"]["embodiment"] == "C8"
    assert call("pair", "learn", "reset", cell).exit_code == 0
    assert store.load("second") is None
    assert not store.frozen


def test_the_report_needs_a_run_and_labels_its_axes(cell: Path) -> None:
    output = cell.parent / "report.html"
    assert call("pair", "report", cell, "-o", output).exit_code == 6
    store = taught(cell)
    cycles = [{"force_n": 60.0, "moment_nm": 9.0, "knots": 1}, {"force_n": None, "moment_nm": None, "knots": 1}]
    run = {"name": "B", "text": "one fixed relation, impedance", "speed": 1.5, "s_m": [0.0, 0.5], "x_m": [0.7, 0.9]}
    run |= {"first_n": [0.0, 60.0], "last_n": [0.0, 50.0], "knots_s_m": [0.0], "cycles": cycles}
    store.write("run-B.json", json.dumps(run))
    assert call("pair", "report", cell, "-o", output).exit_code == 0
    page = output.read_text(encoding="utf-8")
    for said in ("force [N]", "position along the path [m]", "largest force [N]", "figure 18", "<svg"):
        assert said in page
    assert "http" not in page.replace("http://www.w3.org", "")
