"""Every kind of wrong input: where, what, what to do, the exit code, nothing lost, ten lines at most."""

import pytest

from tests.data.slips import SLIPS
from tests.data.wrong_inputs import KINDS, Kind, wrong

ALL = [*KINDS, *SLIPS]


def _marked(kind: Kind) -> object:
    """A diagnosis that searches before it refuses takes seconds."""
    searches = kind.arguments[0] == "diagnose" and kind.code == 7
    return pytest.param(kind, id=kind.name, marks=[pytest.mark.slow] if searches else [])


@pytest.mark.parametrize("kind", [_marked(kind) for kind in ALL])
def test_a_wrong_input_is_answered(kind: Kind) -> None:
    assert not wrong(kind)


def test_there_are_as_many_kinds_as_are_promised_and_none_twice() -> None:
    assert len({kind.name for kind in ALL}) == len(ALL) >= 202
