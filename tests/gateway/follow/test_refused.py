"""What the command refuses before it opens the bus, each with its exit code and reason."""

from __future__ import annotations

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
    load = []
    if result is not None:
        (cell.parent / "r.json").write_text(to_json(result))
        load = ["--load", str(cell.parent / "r.json")]
    words = ["follow", str(cell), "--path", str(cell.parent / "path.toml"), *load, *more]
    return CliRunner().invoke(main, words, input="n\n")


@pytest.mark.parametrize(
    ("result", "code", "words"),
    [
        (None, 6, "no identified load"),
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
    load = None if result is None else cell.parent / "r.json"
    with pytest.raises(GatewayError, match=words) as refused, locked_cell(cell) as context, stoppable() as options:
        follow(context, cell.parent / "path.toml", load, Operator(ask=lambda _what, _meanwhile: None), options)
    assert refused.value.exit_code == code


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
