"""Before a load is mounted, the arm moves to the loading posture, if the cell names it and a path is free."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gateway.acquire.plan import VisitSettings
from gateway.acquire.thermal import Block, blocks_of
from gateway.cell.config import KeepOut
from gateway.data.visit import RestPose
from gateway.jobs.commission import Job, _Robot
from gateway.jobs.frame import Operator
from gateway.model.arm_model import arm_robot
from gateway.motion.joint_path import angles
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from tests.support.rigs.brakes import in_brakes

LOADING = (0.3, 0.5, 0.6, 0.0, 0.4, 0.0)
POSE = RestPose(1, (-0.3, 0.1, 0.1, 0.1, 0.1, 0.1), "fit")


@dataclass
class Person:
    """A person who agrees, and what was done with the arm, in order."""

    loaded: object
    done: list[str] = field(default_factory=list)
    overrides: list[float] = field(default_factory=list)
    keeping: bool = False
    announced: str = ""
    agreed: str = ""

    @contextmanager
    def last_seconds(self, options, opened) -> Generator[None]:
        self.keeping = True
        yield
        self.keeping = False

    def ask(self, question, _meanwhile) -> None:
        self.agreed = question

    def mount(self, label, _opened) -> None:
        self.done.append(f"mount {label}")

    def go(self, _opened, plan, _listeners, options) -> None:
        there = angles(plan.poses[0].q_rad if plan.poses else plan.steps[-1].q_rad)
        assert there in self.announced
        assert there in self.agreed, "announced, then asked"
        assert self.keeping, "a path that ends in a fault leaves a black box"
        self.done.append(f"go to {there}")
        self.overrides.append(options.override)

    def say(self, text) -> None:
        if " goes from " in text:
            self.announced = text
        else:
            self.done.append(text)


@pytest.fixture
def robot(small_cell, workspace, arm, tmp_path, monkeypatch):
    def make(loading, override=1.0, surroundings=workspace, warm_up_s=None) -> tuple[Any, Person]:
        config = small_cell.cell.arm[0].model_copy(update={"loading_rad": loading})
        timing = SimpleNamespace(pacing="lockstep", period_s=0.01)
        opened: Any = SimpleNamespace(
            loaded=small_cell,
            config=config,
            workspace=surroundings,
            arm=arm,
            group=SimpleNamespace(timing=timing, gate=in_brakes),
        )
        person: Any = Person(small_cell)
        operator = Operator(
            ask=person.ask, mount=lambda label, _opened: person.done.append(f"mount {label}"), say=person.say
        )
        monkeypatch.setattr("gateway.jobs.measure.go", person.go)
        monkeypatch.setattr("gateway.jobs.commission.record", lambda *_arguments: person.done.append("measure"))
        job = Job(person, config, ("a", "b"), tmp_path / "run.h5", MoveOptions(override=override), warm_up_s=warm_up_s)
        plan: Any = SimpleNamespace(poses=(POSE,), settings=VisitSettings(0.03, 0.05, 2.0, 40, 0.01))
        return _Robot(job, operator, opened, plan), person

    return make


@pytest.mark.parametrize(("override", "slow"), [(1.0, 0.1), (0.05, 0.05)])
def test_it_goes_there_slowly_before_each_load_and_not_before_the_bare_arm(robot, override, slow):
    made, person = robot(LOADING, override)
    for label in ("none", "a", "b"):
        made.measure_load(Block(label, (POSE,)))
    there = "go to [0.300, 0.500, 0.600, 0.000, 0.400, 0.000] rad"
    assert person.done == ["measure", there, "mount a", "measure", there, "mount b", "measure"]
    assert person.overrides == [slow, slow]


def test_without_such_a_posture_the_load_is_mounted_where_the_arm_is(robot):
    made, person = robot(None)
    made.measure_load(Block("a", (POSE,)))
    assert person.done == ["mount a", "measure"]


def test_a_path_that_is_not_free_is_reported_and_ends_nothing(small_cell, robot, fake):
    wall = KeepOut(min_m=(0.4, 0.15, -2.0), max_m=(3.0, 0.17, 3.0))
    config = small_cell.cell.arm[0].model_copy(update={"keep_out": (wall,)})
    walled = workspace_of(config, arm_robot(small_cell, config))
    tight = replace(walled, lower_rad=np.array([-0.7, -0.1, -0.1, -0.7, -0.7, -0.7]), upper_rad=np.full(6, 0.7))
    made, person = robot((0.6, 0.5, 0.6, 0.0, 0.4, 0.0), surroundings=tight)
    made.measure_load(Block("a", (POSE,)))
    assert "the arm stays at its current posture, mount the load there: no path" in person.done[0]
    assert person.done[1:] == ["mount a", "measure"]
    assert fake.log == []


def test_forth_and_back_a_person_changes_the_load_only_where_it_changes(robot):
    made, person = robot(None, warm_up_s=0.0)
    made.warm_up()
    for block in blocks_of(("a",), (POSE,), is_thermal=True):
        made.measure_load(block)
    assert person.done == ["mount a", "measure", "mount none", "measure", "measure", "mount a", "measure"]


def test_a_resumed_job_asks_which_load_is_mounted(robot, tmp_path, monkeypatch):
    (tmp_path / "run.h5").touch()
    reads = []
    monkeypatch.setattr("gateway.jobs.commission.continued", lambda *_, resume: reads.append(resume))
    made, person = robot(None, warm_up_s=0.0)
    made.measure_load(Block("none", (POSE,)))
    assert (person.done, len(reads)) == (["mount none", "measure"], 2), "read at the start, and for the load"
