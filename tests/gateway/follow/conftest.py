"""Six drives that follow their commands, and the large example arm as the gateway models it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from drives.profile_file import load_profile
from drives.values import DriveCommand, DriveReading
from gateway.cell.config import load_cell
from gateway.cell.conversion import AxisConversion
from gateway.feedforward.load import assumed_load
from gateway.follow.settings import feed_model
from gateway.model.arm_model import arm_robot
from gateway.motion.arm import Arm
from gateway.motion.workspace import workspace_of
from gateway.result.result import Result
from tests.support.rigs.brakes import in_brakes

EXAMPLES = Path(__file__).parents[3] / "examples"
OPERATION_ENABLED, FAULT = 0x1637, 0x0608
PERIOD_S = 0.01


@dataclass(frozen=True)
class Row:
    """What an epoch offers."""

    sync_index: int
    time_s: float
    readings: tuple
    instruments: tuple = ()


@dataclass
class PerfectDrives:
    """Drives that are where they were commanded one SYNC before; the commands are kept."""

    statusword: int = OPERATION_ENABLED
    brake_drop_rad: tuple[float, ...] = (0.0,) * 6
    on_stop: Callable[[], None] = lambda: None
    commanded: list[tuple[DriveCommand, ...]] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)
    at: tuple[float, ...] = (0.0,) * 6
    torque_nm: tuple[float, ...] = (0.0,) * 6
    syncs: int = 0

    def positions_rad(self):
        return self.at

    def _row(self):
        self.syncs += 1
        readings = tuple(
            DriveReading(axis + 1, self.syncs, self.statusword, 0, 0, None, None, p, t, None, None)
            for axis, (p, t) in enumerate(zip(self.at, self.torque_nm, strict=True))
        )
        return Row(self.syncs, PERIOD_S * self.syncs, readings)

    def enable(self, stop_requested=lambda: False):
        self.calls.append("enable")
        return self._row()

    def exchange(self, commands):
        self.commanded.append(tuple(commands))
        row = self._row()
        self.at = tuple(command.position_rad for command in commands)
        return row

    def hold(self):
        self.commanded.append(tuple(DriveCommand(p) for p in self.at))
        return self._row()

    def gate(self):
        return in_brakes()

    def align(self, at_s):
        """There is no clock."""

    @property
    def sync_sent_s(self):
        return PERIOD_S * self.syncs

    def disable(self):
        self.calls.append("disable")

    def quick_stop(self):
        self.calls.append("quick_stop")


@pytest.fixture
def loaded():
    return load_cell(EXAMPLES / "large" / "cell.toml")


@pytest.fixture
def workspace(loaded):
    return workspace_of(loaded.cell.arm[0], arm_robot(loaded, loaded.cell.arm[0]))


@pytest.fixture
def perfect():
    return PerfectDrives()


@pytest.fixture
def arm(loaded, perfect):
    return Arm("main", perfect, AxisConversion.from_arm(loaded.cell.arm[0]))


@pytest.fixture
def feed(loaded):
    """Model of the large arm that the feedforward uses."""
    config = loaded.cell.arm[0]
    return feed_model(config, arm_robot(loaded, config), [load_profile("generic-cia402")] * 6, Result(robot="qh165"))


@pytest.fixture
def law(feed):
    """Its law with 70 kg."""
    return feed.law(assumed_load("a", 70.0, [0.05, -0.02, 0.22], "test"))
