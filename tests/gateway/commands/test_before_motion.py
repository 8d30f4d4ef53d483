"""What can be refused without motion is refused before a bus is opened and before a person is asked."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli import main
from tests.data.wrong_inputs import recording

SMALL = Path(__file__).parents[3] / "examples" / "small" / "cell.toml"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The example cell on a bus where opening it is an error of the test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    def opened(*_args, **_named):
        raise AssertionError("a bus was opened")

    monkeypatch.setattr("drives.bus.open_bus", opened)
    monkeypatch.setattr("gateway.motion.opening.open_arm", opened)
    monkeypatch.setattr("gateway.jobs.cell_context.open_arm", opened)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.toml").write_text(SMALL.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "robot.urdf").write_text((SMALL.parent / "robot.urdf").read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path


def run(words):
    return CliRunner().invoke(main, f"{words} --bus virtual:empty".split(), input="")


@pytest.mark.parametrize("more", ["", "--plan plan.json", "--until mass=1%", "--poses 1", None])
def test_a_recording_of_another_cell_is_refused_before_anything_moves(place, more):
    recording(place, "run.h5")
    (place / "plan.json").write_text('{"kind": "moving_plan"}')
    (place / "cell.toml").write_text((place / "cell.toml").read_text() + "# edited\n")
    command = "commission cell.toml -o ." if more is None else f"record cell.toml --load none -o run.h5 {more}"
    done = run(f"{command} --resume --yes")
    assert done.exit_code == 3, done.output
    assert "run.h5 was recorded with another cell file" in done.stderr


@pytest.mark.parametrize(
    ("code", "command", "says"),
    [
        (3, "record cell.toml --load none -o /proc/run.h5", "-o"),
        (3, "record cell.toml --load none -o new/run.h5 --trace cell.toml/frames.log", "--trace"),
        (3, "record cell.toml --load none -o new/run.h5 --json cell.toml/r.json", "--json"),
        (2, "record cell.toml --load none -o new/run.h5 --poses 0.1", "--poses"),
        (5, "move cell.toml --to 9,9,9,9,9,9", "joint 1"),
        (5, "calibrate cell.toml --known load=12 -o new", "--known"),
        (3, "accept cell.toml cell.toml -o new", "cell.toml"),
    ],
)
def test_a_refusal_opens_no_bus_leaves_no_file_and_shows_no_page(place, code, command, says):
    before = sorted(place.rglob("*"))
    done = run(f"{command} --yes --live")
    assert done.exit_code == code, done.output
    assert says in done.stderr
    assert "live page" not in done.stderr
    assert sorted(place.rglob("*")) == before
