"""What leaves as a file: a recording as measured table, JSON beside what is shown, nothing replaced unasked."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.commands.pages import find_browser
from gateway.data.recording.reader import read
from gateway.data.table import read_csv
from sim.__main__ import main as simulator
from tests.data.wrong_inputs import RESULT, recording


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
        (("run.h5", "--format", "ur"), 2, "the other formats are for a result"),
        (("out.json", "--format", "csv"), 2, "--format csv is for a recording"),
        (("run.h5", "--format", "csv", "--load", "a"), 3, "load 'a' not found; loads in the file: none"),
        (("run.h5", "--format", "csv", "--arm", "left"), 3, "contains the arms main: choose one with --arm"),
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
    summary = json.loads(run("report", source, "-o", page, "--json", "-").stdout)
    assert (summary["report"], summary["robot"]) == (str(page), "r")
    assert page.exists()


def test_an_earlier_page_is_replaced_and_no_other_file(tmp_path):
    source, page, other = tmp_path / "out.json", tmp_path / "r.html", tmp_path / "robot.urdf"
    source.write_text(json.dumps(RESULT))
    for file in (page, other):
        file.write_text("mine")
    for code, output in ((0, page), (3, other), (3, source)):
        assert run("report", source, "-o", output).exit_code == code
    assert "<html" in page.read_text()
    assert other.read_text() == "mine"
    assert json.loads(source.read_text()) == RESULT


def test_both_programs_say_their_version():
    versions = {run("--version").output.split()[-1], CliRunner().invoke(simulator, ["--version"]).output.split()[-1]}
    assert len(versions) == 1


def written(tmp_path, name, **changes):
    """A result file whose load differs."""
    body = {key: value for key, value in RESULT.items() if key != "sha256"}
    load = body["loads"][0] | {"mass_kg": 5.0, "mass_std_kg": 0.02} | changes
    path = tmp_path / name
    path.write_text(json.dumps(body | {"loads": [load]}), encoding="utf-8")
    return path


def test_two_results_are_compared(tmp_path):
    before, after = written(tmp_path, "a.json"), written(tmp_path, "b.json", mass_kg=5.3)
    page, out = tmp_path / "c.html", tmp_path / "new" / "c.json"
    done = run("compare", before, after, "-o", page, "--json", out)
    assert done.exit_code == 7, done.output
    assert "changed: mass of load" in done.stderr
    held = json.loads(out.read_text())
    assert (held["kind"], held["verdict"]) == ("comparison", "changed")
    (mass,) = (row for row in held["quantities"] if row["what"] == "mass")
    assert mass["difference"] == pytest.approx(0.3)
    assert "Before and after" in page.read_text(encoding="utf-8")
    assert run("compare", before, after, "--tolerance", "mass=20%,com=50mm").exit_code == 0
    assert "given: 1;" in run("compare", before).output
    same = run("compare", before, before)
    assert (same.exit_code, "verdict: unchanged" in same.stdout) == (0, True)


BROWSER = """#!/bin/sh
for word in "$@"; do case "$word" in --print-to-pdf=*) printf '%s' "{says}" > "${{word#--print-to-pdf=}}";; esac; done
echo "the last line" >&2
"""


def with_browser(tmp_path, monkeypatch, says):
    folder = tmp_path / "bin"
    folder.mkdir()
    if says is not None:
        (folder / "chromium").write_text(BROWSER.format(says=says), encoding="utf-8")
        (folder / "chromium").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr("gateway.commands.pages.PLACES", ())


@pytest.mark.parametrize(
    ("says", "code", "message"),
    [
        ("%PDF-1.4 page", 0, "report: "),
        ("no page", 3, "printed no PDF (the last line)"),
        (None, 3, "install chromium, or write"),
    ],
)
def test_a_pdf_is_printed_by_the_browser_or_refused(tmp_path, monkeypatch, says, code, message):
    source = written(tmp_path, "a.json")
    with_browser(tmp_path, monkeypatch, says)
    done = run("report", source, "-o", tmp_path / "r.pdf")
    assert (done.exit_code, message in done.output) == (code, True), done.output
    assert (tmp_path / "r.pdf").exists() == (code == 0)
    if code == 0:
        assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_an_installed_browser_prints_the_report(tmp_path):
    if find_browser() is None:
        pytest.skip("no browser is installed")
    done = run("report", written(tmp_path, "a.json"), "-o", tmp_path / "r.pdf")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "r.pdf").read_bytes()[:5] == b"%PDF-"
    assert (tmp_path / "r.pdf").stat().st_size > 10_000
