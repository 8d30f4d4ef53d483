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
    (tmp_path / "cell.toml").write_text(SMALL.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "robot.urdf").write_text((SMALL.parent / "robot.urdf").read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path


def run(place, *words):
    return CliRunner().invoke(main, [str(word) for word in words], input="")


MOVING = ("--load", "none", "--yes", "--bus", "virtual:empty")


@pytest.mark.parametrize(
    ("option", "output"),
    [("-o", "file/run.h5"), ("-o", "/proc/run.h5"), ("--trace", "file/frames.log"), ("--json", "file/r.json")],
)
def test_a_place_that_cannot_be_written_is_refused(place, option, output):
    (place / "file").write_text("no folder", encoding="utf-8")
    words = ["record", place / "cell.toml", *MOVING]
    words += [] if option == "-o" else ["-o", place / "run.h5"]
    done = run(place, *words, option, output if output.startswith("/") else place / output)
    assert done.exit_code == 3, done.output
    assert option in done.stderr
    assert "a bus was opened" not in done.output


@pytest.mark.parametrize("more", [(), ("--moving",), ("--until", "mass=1%"), ("--pose", "1")])
def test_a_recording_of_another_cell_is_refused_before_anything_moves(place, more):
    path = recording(place, "run.h5")
    text = (place / "cell.toml").read_text(encoding="utf-8")
    (place / "cell.toml").write_text(text.replace("speed_limit_rad_s = 0.8", "speed_limit_rad_s = 0.7", 1))
    done = run(place, "record", place / "cell.toml", *MOVING, "-o", path, "--resume", *more)
    assert done.exit_code == 3, done.output
    assert "run.h5 was recorded with another cell file" in done.stderr


def test_a_commissioning_that_is_gone_on_with_under_another_cell_is_refused(place):
    recording(place, "run.h5")
    (place / "cell.toml").write_text((place / "cell.toml").read_text() + "# edited\n")
    done = run(place, "commission", place / "cell.toml", "--out", place, "--resume", "--bus", "virtual:empty")
    assert done.exit_code == 3, done.output
    assert "another cell file" in done.stderr


def test_nothing_is_left_behind_by_looking(place):
    before = sorted(place.rglob("*"))
    done = run(place, "record", place / "cell.toml", *MOVING, "-o", place / "new" / "run.h5", "--pose", "0.1")
    assert done.exit_code == 2
    assert sorted(place.rglob("*")) == before
