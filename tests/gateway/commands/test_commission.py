"""Before a load is mounted, the arm moves to the loading posture, if the cell names it and a path is free."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gateway.acquire.goto import transfer_from_here
from gateway.acquire.plan import VisitSettings
from gateway.acquire.thermal import Block, blocks_of
from gateway.cell.config import KeepOut
from gateway.data.rest_pose import RestPose
from gateway.jobs.commission import Job, _Robot
from gateway.model.arm_model import arm_robot
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from tests.support.rigs.brakes import in_brakes

LOADING = (0.3, 0.5, 0.6, 0.0, 0.4, 0.0)
POSE = RestPose(1, (-0.3, 0.1, 0.1, 0.1, 0.1, 0.1), "fit")


@dataclass
class Listener:
    """A person who agrees, and what was done with the arm, in order."""

    loaded: object
    done: list[str] = field(default_factory=list)
    overrides: list[float] = field(default_factory=list)
    keeping: bool = False
    asked: str = ""

    @contextmanager
    def last_seconds(self, options, opened) -> Generator[None]:
        self.keeping = True
        yield
        self.keeping = False

    def announced(self, _opened, target, _plan, _options) -> None:
        self.asked = f"will move to {target}. Is the area clear of people?"

    def ask(self, question, _meanwhile) -> None:
        assert question.endswith(self.asked)
        self.asked = ""

    def bring(self, opened, target, plan, options) -> None:
        assert not self.asked, "announced and asked before"
        assert transfer_from_here(opened, target, plan) is plan, "planned once"
        assert self.keeping, "a path that ends in a fault leaves a black box"
        self.done.append(str(target))
        self.overrides.append(options.override)

    def mount(self, label, _opened) -> None:
        self.done.append(f"mount {label}")

    def measure(self, *_arguments) -> None:
        self.done.append("measure")

    def say(self, text) -> None:
        self.done.append(text)


@pytest.fixture
def robot(small_cell, workspace, arm, tmp_path):
    def make(loading, override=1.0, surroundings=workspace, warm_up_s=None) -> tuple[Any, Listener]:
        config = small_cell.cell.arm[0].model_copy(update={"loading_rad": loading})
        timing = SimpleNamespace(pacing="lockstep", period_s=0.01)
        opened: Any = SimpleNamespace(
            loaded=small_cell,
            config=config,
            workspace=surroundings,
            arm=arm,
            group=SimpleNamespace(timing=timing, gate=in_brakes),
        )
        listener: Any = Listener(small_cell)
        job = Job(
            listener, config, ("a", "b"), tmp_path / "run.h5", MoveOptions(override=override), warm_up_s=warm_up_s
        )
        plan: Any = SimpleNamespace(poses=(POSE,), settings=VisitSettings(0.03, 0.05, 2.0, 40, 0.01))
        return _Robot(job, listener, opened, plan), listener

    return make


@pytest.mark.parametrize(("override", "slow"), [(1.0, 0.1), (0.05, 0.05)])
def test_it_goes_there_slowly_before_each_load_and_not_before_the_bare_arm(robot, override, slow):
    made, person = robot(LOADING, override)
    for label in ("none", "a", "b"):
        made.measure_load(Block(label, (POSE,)))
    there = "the loading posture, [0.300, 0.500, 0.600, 0.000, 0.400, 0.000] rad"
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
    monkeypatch.setattr(_Robot, "_stored", lambda _self: None)
    made, person = robot(None, warm_up_s=0.0)
    made.measure_load(Block("none", (POSE,)))
    assert person.done == ["mount none", "measure"]
