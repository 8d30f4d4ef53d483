"""Every packaged profile against a simulated drive that is built from it: enable, move, read, stop."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drives.bus import BusSpec, open_bus
from drives.drive import AxisSetup, DriveCommand
from drives.group import DriveGroup, GroupOptions
from drives.profile_file import list_profiles, load_profile

pytest.importorskip("pybullet", reason="the simulated drives need the extra [sim]")
from sim.serve import running

EXAMPLE = Path(__file__).parents[2] / "examples" / "small"
PERIOD_S = 0.01
#: Nothing here is about time, and the machine may be busy.
PATIENT = GroupOptions(answer_timeout_s=20.0, gap_timeout_s=2.0)


@pytest.fixture
def cell(tmp_path, request):
    """The small cell with the drives of one profile."""
    text = (EXAMPLE / "cell.toml").read_text().replace('"generic-cia402"', f'"{request.param}"')
    (tmp_path / "cell.toml").write_text(text)
    (tmp_path / "robot.urdf").write_text((EXAMPLE / "robot.urdf").read_text())
    return request.param, tmp_path / "cell.toml"


def is_known(name):
    """Whether the arithmetic of a profile is whole; it may still be refused for an unnamed encoder."""
    profile = load_profile(name)
    return not (profile.torque.assumed or profile.no_motion)


@pytest.mark.parametrize("cell", [name for name in list_profiles() if is_known(name)], indirect=True)
def test_a_drive_of_every_profile_is_enabled_moved_and_read(cell):
    name, path = cell
    profile = load_profile(name)
    with (
        running(path, f"virtual:conformance-{name}", pacing="lockstep") as handle,
        open_bus(BusSpec.parse(handle.bus)) as bus,
    ):
        unit = handle.simulation.arms[0]
        setups = [
            AxisSetup(drive.node_id, profile, drive.spec.torque_constant_nm_per_a, 400.0) for drive in unit.drives
        ]
        with DriveGroup(bus, setups, PERIOD_S, options=PATIENT) as group:
            identities = group.connect()
            assert all(name in identity.name for identity in identities)
            group.configure()
            start = group.enable()
            drives = group.drives
            steps = [math.copysign(0.05, unit.drives[axis].spec.position_sign) for axis in range(6)]
            for _ in range(100):
                group.exchange(
                    [
                        DriveCommand(drive.target_count * drive.scale.count_rad + step)
                        for drive, step in zip(drives, steps, strict=True)
                    ]
                )
            epochs = [group.hold() for _ in range(100)]
            moved = [
                after.position_rad - before.position_rad
                for before, after in zip(start.readings, epochs[-1].readings, strict=True)
            ]
            assert moved == pytest.approx([100 * step for step in steps], abs=0.05)
            for fake, drive, reading in zip(unit.drives, drives, epochs[-1].readings, strict=True):
                true_nm = fake.reading_nm / (fake.spec.torque_sign * fake.spec.gear_ratio)
                # half a bit, and what the drive rounds off when it shows its rated torque in mNm
                rounding_nm = 0.51 * drive.scale.torque_nm + 2e-3 * abs(true_nm)
                assert reading.torque_nm == pytest.approx(true_nm, abs=rounding_nm)
                if reading.current_a is not None:
                    true_a = true_nm / fake.spec.torque_constant_nm_per_a
                    assert reading.current_a == pytest.approx(true_a, rel=1e-3, abs=0.51 * drive.scale.current_a)
            group.disable()
            statistics = group.statistics
            assert (statistics.incomplete, statistics.late, sum(statistics.foreign.values())) == (0, 0, 0)
