"""What leaves as a file: a recording as measured table, JSON beside what is shown, nothing replaced unasked."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.data.recording.reader import read
from gateway.data.table import read_csv
from sim.__main__ import main as simulator
from tests.wrong_inputs import RESULT, recording


def run(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_a_recording_leaves_as_the_table_that_estimate_reads(tmp_path):
    path, out = recording(tmp_path), tmp_path / "t.csv"
    assert run("export", path, "--format", "csv", "-o", out).exit_code == 0
    written, held = read_csv(out, None), read(path).table()
    assert written.pose.tolist() == held.pose.tolist()
    assert written.load.tolist() == held.load.tolist()
    for name in ("q_rad", "tau_nm", "tau_std_nm", "direction", "time_s", "count"):
        assert np.array_equal(getattr(written, name), getattr(held, name)), name
    assert run("export", path, "--format", "csv").stdout.splitlines() == out.read_text().splitlines()


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("run.h5", "--format", "ur"), 2, "every other format of a result"),
        (("out.json", "--format", "csv"), 2, "--format csv is of a recording"),
        (("run.h5", "--format", "csv", "--load", "a"), 3, "load 'a' is not in it; it holds none"),
        (("run.h5", "--format", "csv", "--arm", "left"), 3, "holds the arms main: name one of them by --arm"),
    ],
)
def test_what_cannot_leave_so_is_said(tmp_path, monkeypatch, arguments, code, says):
    monkeypatch.chdir(tmp_path)
    recording(tmp_path)
    (tmp_path / "out.json").write_text(json.dumps(RESULT))
    done = run("export", *arguments)
    assert (done.exit_code, says in done.stderr) == (code, True), done.output


def test_what_is_shown_is_there_as_json_too(tmp_path):
    listed = json.loads(run("profiles", "list", "--json", "-").stdout)
    assert "generic-cia402" in [profile["name"] for profile in listed["profiles"]]
    source, page = tmp_path / "out.json", tmp_path / "r.html"
    source.write_text(json.dumps(RESULT))
    told = json.loads(run("report", source, "-o", page, "--json", "-").stdout)
    assert (told["report"], told["robot"]) == (str(page), "r")
    assert page.exists()


def test_force_replaces_what_is_there(tmp_path):
    source, page = tmp_path / "out.json", tmp_path / "r.html"
    source.write_text(json.dumps(RESULT))
    page.write_text("mine")
    assert run("report", source, "-o", page).exit_code == 3
    assert page.read_text() == "mine"
    assert run("report", source, "-o", page, "--force").exit_code == 0
    assert "<html" in page.read_text()


def test_both_programs_say_their_version():
    versions = {run("--version").output.split()[-1], CliRunner().invoke(simulator, ["--version"]).output.split()[-1]}
    assert len(versions) == 1
