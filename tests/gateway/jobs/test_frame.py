"""Between opened drives and their first motion: the gate, the question, and what happens until it is answered."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drives.errors import DriveFault, DriveRebooted
from gateway.jobs.frame import Operator, ask_to_move
from tests.support.rigs.brakes import in_brakes


def arm(name, gate=in_brakes, attend=lambda: None):
    return SimpleNamespace(
        config=SimpleNamespace(name=name),
        group=SimpleNamespace(gate=gate, attend=attend),
        arm=SimpleNamespace(where=lambda: np.zeros(6)),
        workspace=SimpleNamespace(path_into_range=lambda _q: None, why_not=lambda _q: None),
    )


def context(pair=None):
    return SimpleNamespace(loaded=SimpleNamespace(cell=SimpleNamespace(name="both", pair=pair)))


@pytest.mark.parametrize(
    ("arms", "pair", "question"),
    [
        (["one"], None, "Arm 'one' of cell 'both' will move. Is the area clear of people?"),
        (["one"], "a pair", "Arm 'one' of cell 'both' will move. Are both grippers open? Is the area clear of people?"),
        (["one", "two"], "a pair", "Arms 'one' and 'two' of cell 'both' will move. Is the area clear of people?"),
    ],
)
def test_an_arm_of_a_pair_moves_alone_with_open_grippers_only(arms, pair, question):
    asked = []
    operator = Operator(ask=lambda text, _meanwhile: asked.append(text))
    ask_to_move(context(pair), [arm(name) for name in arms], operator, "will move.", lambda: asked.append("before"))
    assert asked == ["before", question]


@pytest.mark.parametrize("reason", ["failure", "unsafe"])
def test_no_person_is_asked_and_no_page_opens_for_an_arm_that_cannot_be_enabled_or_approached(reason):
    def faulty(*, full):
        (drive,) = in_brakes(full=full).drives
        return replace(in_brakes(full=full), drives=(replace(drive, **{reason: DriveFault("is in FAULT", node=1)}),))

    with pytest.raises(DriveFault, match="is in FAULT"):
        ask_to_move(context(), [arm("one"), arm("two", faulty)], Operator(ask=pytest.fail), "will move.", pytest.fail)


def test_a_change_of_any_arm_ends_the_question():
    def rebooted():
        raise DriveRebooted("restarted", node=1)

    operator = Operator(ask=lambda _text, meanwhile: meanwhile())
    with pytest.raises(DriveRebooted):
        ask_to_move(context(), [arm("one"), arm("two", attend=rebooted)], operator, "will move.")
