"""A body that stays mounted has one mass: delayed mounting, two loads of one label, a load in the unloaded run."""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

from gateway.cli import main
from tests.data.mounted import table_text
from tests.data.moving_arm import URDF

POSES = 12
LOAD, HEAVIER, MOVED = (5.0, 0.02, 0.03, 0.11), (7.3, 0.02, 0.03, 0.11), (5.0, 0.08, -0.04, 0.16)


def mounted(*parts):
    """Payload of each pose, from (count, payload)."""
    return [payload for count, payload in parts for _ in range(count)]


BARE, LOADED = mounted((POSES, None)), mounted((POSES, LOAD))
CHANGED = {
    "mounted with delay": (
        BARE,
        mounted((4, None), (8, LOAD)),
        r"0\S* kg up to pose 4, (4\.9|5\.0)\d? kg from pose 5 on",
    ),
    "taken off early": (BARE, mounted((8, LOAD), (4, None)), r"(4\.9|5\.0)\d? kg up to pose 8, \S+ kg from pose 9 on"),
    "two loads of one label": (BARE, mounted((6, LOAD), (6, HEAVIER)), r"up to pose 6, 7\.\d+ kg from pose 7 on"),
    "taken off during the unloaded run": (
        mounted((6, LOAD), (6, None)),
        LOADED,
        r"(4\.9|5\.0)\d? kg up to pose 6, 0 kg from pose 7 on",
    ),
    "mounted during the unloaded run": (
        mounted((6, None), (6, LOAD)),
        LOADED,
        r"\b0 kg up to pose 6, (4\.9|5\.0)\d? kg from pose 7 on .* unloaded run\?",
    ),
}


def answer(folder, command, bare, loaded, **about):
    """Exit code and result of a command on a table of these payloads."""
    (folder / "t.csv").write_text(table_text(1, [("none", bare), ("tool", loaded)], **about))
    (folder / "robot.urdf").write_text(URDF)
    result = folder / "r.json"
    options = ("--robot", str(folder / "robot.urdf"), "--inertials", "prior:0.05", "--json", str(result))
    done = CliRunner().invoke(main, [command, str(folder / "t.csv"), *options])
    return done.exit_code, json.loads(result.read_text())


@pytest.mark.parametrize("command", ["estimate", "diagnose"])
@pytest.mark.parametrize("what", CHANGED)
def test_a_change_of_mass_is_refused_by_every_command(tmp_path, what, command):
    bare, loaded, reason = CHANGED[what]
    code, result = answer(tmp_path, command, bare, loaded)
    (load,) = result["loads"]
    assert (code, load["mass_kg"], result["effects"]) == (7, None, [])
    assert re.search(reason, load["refused"]), load["refused"]
    exported = CliRunner().invoke(main, ["export", str(tmp_path / "r.json"), "--format", "json"])
    assert exported.exit_code == 6
    assert "has no mass to export" in exported.stderr


NOT_CHANGED = {
    "the same load": (LOADED, {}),
    "a load that shifts": (mounted((6, LOAD), (6, MOVED)), {}),
    "readings that fall by 4 %": (LOADED, {"falls_by": 0.04}),
    "gains that differ by 10 %": (LOADED, {"gain_std": 0.1}),
    "one pose without it": (mounted((1, None), (11, LOAD)), {}),
}


@pytest.mark.parametrize("what", NOT_CHANGED)
def test_what_keeps_its_mass_is_not_refused(tmp_path, what):
    loaded, about = NOT_CHANGED[what]
    code, result = answer(tmp_path, "estimate", BARE, loaded, **about)
    assert code == 0
    assert result["loads"][0]["mass_kg"] == pytest.approx(5.0, abs=0.6)


@pytest.mark.parametrize("command", ["estimate", "diagnose"])
def test_the_unloaded_run_alone_and_a_known_load_are_judged_too(tmp_path, command):
    (tmp_path / "robot.urdf").write_text(URDF)
    reason = "its rows contradict each other: "
    reference = ("--known", "ref=5,0.02,0.03,0.11")
    for loads, known, code in (
        ([("none", CHANGED["mounted during the unloaded run"][0])], (), 6),
        ([("none", BARE), ("tool", LOADED), ("ref", CHANGED["mounted with delay"][1])], reference, 7),
    ):
        (tmp_path / "t.csv").write_text(table_text(1, loads))
        options = ("--robot", str(tmp_path / "robot.urdf"), "--inertials", "prior:0.05", *known)
        done = CliRunner(env={"COLUMNS": "400"}).invoke(main, [command, str(tmp_path / "t.csv"), *options])
        assert (done.exit_code, reason in done.output) == (code, True), done.output
