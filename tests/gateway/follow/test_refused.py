"""What the command refuses before it opens the bus, each with its exit code and reason."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.errors import GatewayError
from gateway.jobs.cell_context import locked_cell
from gateway.jobs.follow import follow
from gateway.jobs.frame import Operator, stoppable
from gateway.result.drawn import Drawn
from gateway.result.result import LoadResult, Result, to_json

EXAMPLES = Path(__file__).parents[3] / "examples"
LOAD = LoadResult("a", 70.0, 0.2, (0.05, -0.02, 0.22), (0.001, 0.001, 0.002))
RESULT = Result(robot="qh165", loads=(LOAD,), data=Drawn(cell="large", arm="main"))


@pytest.fixture
def cell(tmp_path):
    for file in (EXAMPLES / "large").glob("*"):
        shutil.copy(file, tmp_path / file.name)
    text = (tmp_path / "cell.toml").read_text().replace('"udp_multicast"', '"virtual"')
    (tmp_path / "cell.toml").write_text(text.replace("options = { port = 43113 }", ""))
    return tmp_path / "cell.toml"


def change(file, old, new, count=1):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, count))


def run(cell, result, *more):
    (cell.parent / "r.json").write_text(to_json(result))
    words = ["follow", str(cell), str(cell.parent / "r.json"), "--path", str(cell.parent / "path.toml"), *more]
    return CliRunner().invoke(main, words, input="n\n")


@pytest.mark.parametrize(
    ("result", "code", "words"),
    [
        (replace(RESULT, loads=()), 6, "holds no identified load"),
        (replace(RESULT, loads=(replace(LOAD, refused="rows contradict"),)), 6, "rows contradict"),
        (replace(RESULT, robot="kr300"), 3, "identified on robot 'kr300'"),
        (replace(RESULT, data=Drawn(cell="small")), 3, "identified on cell 'small'"),
        (replace(RESULT, loads=(replace(LOAD, frame="flange"),)), 3, "frame 'flange'"),
        (replace(RESULT, loads=(replace(LOAD, mass_kg=800.0),)), 5, "the feedforward requires"),
    ],
)
def test_a_load_that_may_not_be_fed_is_refused(cell, result, code, words):
    done = run(cell, result, "--yes")
    said = words in done.output, done.output.count("error:")
    assert (done.exit_code, *said) == (code, True, 1), done.output
    load = cell.parent / "r.json"
    with pytest.raises(GatewayError, match=words) as refused, locked_cell(cell) as context, stoppable() as options:
        follow(context, cell.parent / "path.toml", load, Operator(ask=lambda _what, _meanwhile: None), options)
    assert refused.value.exit_code == code


def test_a_wrong_path_is_refused_before_the_keyboard_and_the_page_are_opened(cell, monkeypatch, capfd):
    path, load = cell.parent / "path.toml", cell.parent / "r.json"
    path.write_text("waypoints_rad = 1\n")
    load.write_text(to_json(RESULT))
    for opening in ("tty.setcbreak", "gateway.live.page.LivePage"):
        monkeypatch.setattr(opening, pytest.fail)
    keyboard, terminal = os.openpty()
    with os.fdopen(keyboard), os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(SystemExit) as ended:
            main(["follow", str(cell), str(load), "--path", str(path), "--hold-to-run", "--live"])
    assert (ended.value.code, str(path) in capfd.readouterr().err) == (3, True)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rotor_inertia_kg_m2 = { value = 220,", "rotor_inertia_kg_m2 = { value = -1,", "rotor_inertia_kg_m2"),
        ("rated_load_kg = { value = 165,", "rated_load_kg = { value = 0,", "rated_load_kg"),
        ("rotor_inertia_kg_m2 = { value = 220, source", "rotor_inertia_kg_m2 = { value = 220 } #", "source"),
        ("rated_load_kg", "# rated_load_kg", "rated_load_kg is missing"),
        ('"generic-cia402"', '"kollmorgen-akd-x00606"', "axis 1 (node 1, kollmorgen-akd-x00606)"),
    ],
)
def test_a_cell_without_constants_or_objects_is_refused(cell, old, new, words):
    change(cell, old, new)
    done = run(cell, RESULT, "--yes")
    assert (done.exit_code, words in done.output) == (3, True), done.output
