"""What every command that moves has in common."""

from __future__ import annotations

from typing import Any

import pytest

from gateway.commands.motion_options import MoveChoice, move_options
from gateway.motion.stops import StoppedByPerson

MOVE: dict[str, Any] = {"override": 50, "hold_to_run": False, "yes": True, "pacing": None, "live": False}


def printing(moving: MoveChoice, **_named: Any) -> None:
    """A command whose output is closed."""
    assert moving.override == 50
    raise BrokenPipeError


@pytest.mark.parametrize("named", [{}, {"move": True, "prove_stop": False}, {"brakes": True}])
def test_a_terminal_that_goes_away_before_anything_moves_ends_the_command_as_a_person_does(named):
    with pytest.raises(StoppedByPerson, match="the terminal was closed"):
        move_options(printing)(**MOVE, **named)


def test_a_check_that_moves_nothing_is_no_motion_that_was_stopped():
    with pytest.raises(BrokenPipeError):
        move_options(printing)(**MOVE, move=False, prove_stop=False, brakes=False)


def test_another_error_stays_what_it_is():
    def failing(**_named: Any) -> None:
        raise FileNotFoundError("cell.toml")

    with pytest.raises(FileNotFoundError):
        move_options(failing)(**MOVE)
