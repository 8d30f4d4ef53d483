"""What an arm's drives are given of the cell, and how an arm sees them."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from drives.bus import BusSpec
from drives.errors import ProfileError
from gateway.cell.config import LoadedCell, with_pacing
from gateway.cell.conversion import AxisConversion
from gateway.errors import InputError
from gateway.feedforward.identified import with_identified
from gateway.motion import opening
from gateway.motion.opening import axis_setups
from gateway.result.drawn import Drawn
from gateway.result.result import AxisMotion, Result, to_json


def test_each_drive_gets_node_profile_constant_and_the_speed_of_its_motor(small_cell):
    """A joint at its speed limit turns its motor by the gear ratio times as fast."""
    config = small_cell.cell.arm[0]
    setups = axis_setups(small_cell, config)
    assert [setup.node_id for setup in setups] == [axis.node_id for axis in config.axis]
    for setup, axis in zip(setups, config.axis, strict=True):
        assert setup.profile.name == axis.profile
        assert setup.torque_constant_nm_per_a == axis.torque_constant_nm_per_a.value
        assert setup.max_motor_speed_rad_s == pytest.approx(abs(axis.gear_ratio.value) * axis.speed_limit_rad_s)
        assert not setup.offsets


def test_a_motor_that_turns_with_two_joints_may_be_as_fast_as_both_together(small_cell):
    coupling = np.eye(6)
    coupling[5, 4] = -0.5
    config = small_cell.cell.arm[0].model_copy(update={"coupling": tuple(map(tuple, coupling.tolist()))})
    setups = axis_setups(small_cell, config)
    five, six = config.axis[4], config.axis[5]
    both = abs(six.gear_ratio.value) * (six.speed_limit_rad_s + 0.5 * five.speed_limit_rad_s)
    assert setups[5].max_motor_speed_rad_s == pytest.approx(both)
    assert setups[4].max_motor_speed_rad_s == pytest.approx(abs(five.gear_ratio.value) * five.speed_limit_rad_s)
    assert (setups[5].position_limit_rad, setups[4].position_limit_rad is None) == (None, False)


def test_a_profile_that_is_not_packaged_is_a_file_beside_the_cell(small_cell, tmp_path):
    config = small_cell.cell.arm[0]
    own = config.model_copy(
        update={"axis": tuple(axis.model_copy(update={"profile": "mine.toml"}) for axis in config.axis)}
    )
    loaded = LoadedCell(cell=small_cell.cell, text=small_cell.text, folder=tmp_path)
    with pytest.raises(ProfileError, match=r"mine\.toml"):
        axis_setups(loaded, own)
    text = axis_setups(small_cell, config)[0].profile.text.replace('eds = "generic-cia402.eds"\n', "")
    (tmp_path / "mine.toml").write_text(text)
    assert axis_setups(loaded, own)[0].profile.text == text
    (tmp_path / "mine.toml").unlink()
    assert len({id(setup.profile) for setup in axis_setups(with_pacing(loaded, "lockstep"), own)}) == 1, "read once"


class Group:
    """As much of a drive group as an arm asks for."""

    def __init__(self) -> None:
        self.sync_index = 0
        self.limits_nm: list[float | None] = []
        self.connect = lambda: ()

    def of(self, _bus, setups, *_pacing, **_options) -> nullcontext[Group]:
        """Take the settings as the group of these drives does."""
        self.setups = setups
        self.drives = [
            SimpleNamespace(
                access=SimpleNamespace(read=lambda entry, setup=setup: {0x6064: 1000}[entry.index] * setup.node_id),
                scale=SimpleNamespace(count_rad=0.001, constants=None),
                setup=setup,
            )
            for setup in setups
        ]
        return nullcontext(self)

    def configure(self) -> None:
        self.limits_nm = [drive.setup.torque_limit_nm for drive in self.drives]


@pytest.fixture
def group(monkeypatch) -> Group:
    """What `open_arm` takes for the drives on the bus; they pass its check and say nothing of their ramps."""
    group = Group()
    monkeypatch.setattr(opening, "open_bus", lambda *_: nullcontext())
    monkeypatch.setattr(opening, "DriveGroup", group.of)
    monkeypatch.setattr(opening.drive_limits, "quick_stop_rad_s2", lambda *_: None)
    monkeypatch.setattr(opening, "look_over", lambda *_: ((), ()))
    return group


@pytest.mark.parametrize("harder", ["ramp", "motion"])
def test_a_drive_gives_no_more_torque_than_the_harder_of_motion_and_quick_stop_needs(
    small_cell, workspace, monkeypatch, group, harder
):
    config = small_cell.cell.arm[0]
    ramp = workspace.acceleration_rad_s2 * (3.0 if harder == "ramp" else 0.3)
    monkeypatch.setattr(opening.drive_limits, "quick_stop_rad_s2", lambda *_: ramp)
    monkeypatch.setattr(
        opening.drive_limits, "needed_torque_nm", lambda _space, _config, hardest, _known: 10.0 * hardest
    )
    with opening.open_arm(small_cell):
        pass
    ratio = np.abs(AxisConversion.from_arm(config).ratio)
    expected = 10.0 * np.maximum(ramp, workspace.acceleration_rad_s2) / ratio
    assert group.limits_nm == pytest.approx(expected.tolist())


def test_where_a_ramp_is_not_known_no_torque_is_limited(small_cell, group):
    with opening.open_arm(small_cell):
        pass
    assert group.limits_nm == [None] * 6


@pytest.mark.parametrize("bus_name", [None, BusSpec("virtual", "elsewhere")])
def test_the_bus_is_that_of_the_cell_unless_another_one_is_given(small_cell, monkeypatch, bus_name):
    open_bus = Mock(side_effect=ConnectionError)
    monkeypatch.setattr(opening, "open_bus", open_bus)
    with pytest.raises(ConnectionError), opening.open_arm(small_cell, bus_name):
        pass
    bus = small_cell.cell.bus[small_cell.cell.arm[0].bus]
    own = BusSpec(bus.interface, bus.channel, bus.bitrate_bit_s, dict(bus.options))
    open_bus.assert_called_once_with(bus_name or own)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[torque]\n", '[torque]\nbasis = "assumed"\n', "what one bit of the torque"),
        ("abort_connection = 3", "abort_connection = 2", "lets a moving axis coast"),
        ('name = "generic-cia402"', 'name = "generic-cia402"\nno_motion = ["no 0x1016: it is deaf"]', "no 0x1016"),
    ],
)
def test_a_drive_that_is_read_and_not_moved_is_refused_before_the_bus_is_opened(
    small_cell, tmp_path, monkeypatch, old, new, says
):
    config = small_cell.cell.arm[0]
    text = axis_setups(small_cell, config)[0].profile.text.replace('eds = "generic-cia402.eds"\n', "")
    (tmp_path / "mine.toml").write_text(text.replace('basis = "standard"\n', "").replace(old, new, 1))
    shutil.copy(small_cell.folder / config.robot, tmp_path / config.robot)
    axes = tuple(
        axis.model_copy(update={"profile": "mine"}) if joint in (2, 5) else axis
        for joint, axis in enumerate(config.axis, start=1)
    )
    cell = small_cell.cell.model_copy(update={"arm": (config.model_copy(update={"axis": axes}),)})
    monkeypatch.setattr(opening, "open_bus", lambda *_: pytest.fail("the bus was opened"))
    loaded = LoadedCell(cell=cell, text=small_cell.text, folder=tmp_path)
    with pytest.raises(ProfileError, match=says) as caught, opening.open_arm(loaded):
        pass
    assert "J2, J5: profile generic-cia402 refuses motion" in str(caught.value)
    assert caught.value.exit_code == 3


def test_what_was_identified_elsewhere_is_refused_before_the_bus_is_opened(small_cell, tmp_path, monkeypatch):
    config = small_cell.cell.arm[0]
    motion = (AxisMotion(1, coulomb_nm=5.0, coulomb_std_nm=0.1),)
    elsewhere = Result(robot="compact10", motion=motion, data=Drawn(cell="small", arm="other"))
    (tmp_path / "moving.json").write_text(to_json(elsewhere))
    monkeypatch.setattr(opening, "open_bus", lambda *_: pytest.fail("the bus was opened"))
    loaded = with_identified(small_cell, config.name, tmp_path / "moving.json")
    with pytest.raises(InputError, match="arm 'other', not on"), opening.open_arm(loaded):
        pass
