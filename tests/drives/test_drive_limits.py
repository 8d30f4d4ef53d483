"""Limits of position and torque: kept by the master, and given to the drive where that is allowed."""

from __future__ import annotations

import math

import pytest

from drives.drive import DriveCommand
from drives.drive_limits import limit_torque
from drives.errors import CommandRefused, ConfigurationRefused, DriveFault, ProfileError
from drives.group import DriveGroup, GroupOptions
from drives.profile_file import load_profile
from drives.values import AxisSetup

PERIOD_S = 0.004
TURN = 65536
COUNT_RAD = 2 * math.pi / TURN
RATED_NM = 2.0


@pytest.fixture
def slave(make_slave):
    """At 1000 counts, with 0x6072 = 3000 per mille and 0x607D = -/+ 400000 counts."""
    slave = make_slave(1)
    for address, kind, value in (
        ((0x6072, 0), "u16", 3000),
        ((0x607D, 1), "i32", -400_000),
        ((0x607D, 2), "i32", 400_000),
    ):
        slave.types[address], slave.values[address] = kind, value
    return slave


def allowing(profile, *more, without=()):
    allow = (*(index for index in profile.write.allow if index not in without), *more)
    return profile.model_copy(update={"write": profile.write.model_copy(update={"allow": allow})})


def ready(bus, profile, options=None, **limits):
    group = DriveGroup(bus, [AxisSetup(1, profile, 0.5, 300.0, **limits)], PERIOD_S, options=options)
    group.connect()
    group.configure()
    return group


# -- targets ----------------------------------------------------------------------------------------------------------


def test_limits_are_motor_angles_and_the_last_count_inside_is_allowed(bus, slave, generic):
    with ready(bus, generic, position_limit_rad=(899.4 * COUNT_RAD, 1100.6 * COUNT_RAD)) as group:
        group.enable()
        group.exchange([DriveCommand(1100 * COUNT_RAD)])
        for outside in (1101, 899):
            with pytest.raises(CommandRefused, match=r"outside 900 \.\. 1100"):
                group.exchange([DriveCommand(outside * COUNT_RAD)])
        group.exchange([DriveCommand(900 * COUNT_RAD)])


@pytest.mark.parametrize(("found", "side"), [(5000, 1), (-5000, -1)])
def test_an_axis_found_outside_moves_only_inwards(bus, slave, generic, found, side):
    slave.position = found
    with ready(bus, generic, position_limit_rad=(-100 * COUNT_RAD, 100 * COUNT_RAD)) as group:
        group.enable()
        group.exchange([DriveCommand(found * COUNT_RAD)])
        group.exchange([DriveCommand((found - 50 * side) * COUNT_RAD)])
        for outward in (found - 49 * side, found, -side * 101):
            with pytest.raises(CommandRefused, match="moves only inwards"):
                group.exchange([DriveCommand(outward * COUNT_RAD)])
        group.exchange([DriveCommand(side * 100 * COUNT_RAD)])
        with pytest.raises(CommandRefused):
            group.exchange([DriveCommand(side * 101 * COUNT_RAD)])


@pytest.mark.parametrize(("found", "side"), [(5000, 1), (-5000, -1)])
def test_an_axis_held_outside_stays_where_it_is_when_a_path_inwards_begins_a_hair_further_out(
    bus, slave, generic, found, side
):
    """What is read while it is held differs by some counts from what it was commanded to hold."""
    slave.position = found
    with ready(bus, generic, position_limit_rad=(-100 * COUNT_RAD, 100 * COUNT_RAD)) as group:
        group.enable()
        group.exchange([DriveCommand((found + 3 * side) * COUNT_RAD)])
        assert group.drives[0].target_count == found
        with pytest.raises(CommandRefused, match="moves only inwards"):
            group.exchange([DriveCommand((found + 200 * side) * COUNT_RAD)])
        group.exchange([DriveCommand((found - 2 * side) * COUNT_RAD)])
        assert group.drives[0].target_count == found - 2 * side
        with pytest.raises(CommandRefused, match="moves only inwards"):
            group.exchange([DriveCommand((found - side) * COUNT_RAD)])


@pytest.mark.parametrize("limit", [(1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_limits_that_are_none_are_refused(generic, limit):
    with pytest.raises(ProfileError, match="not in order"):
        AxisSetup(1, generic, 0.5, 300.0, position_limit_rad=limit)


# -- 0x607D -----------------------------------------------------------------------------------------------------------

LIMIT_RAD = (-100_000 * COUNT_RAD, 200_000 * COUNT_RAD)


def held(slave):
    return slave.values[0x607D, 1], slave.values[0x607D, 2]


def test_the_drive_gets_the_limits_half_a_revolution_wider_and_its_own_back(bus, slave, generic):
    with ready(bus, allowing(generic, 0x607D), position_limit_rad=LIMIT_RAD) as group:
        assert held(slave) == (-100_000 - TURN // 2, 200_000 + TURN // 2)
        group.restore()
    assert held(slave) == (-400_000, 400_000)


@pytest.mark.parametrize(
    ("own", "new"),
    [
        ((-120_000, 150_000), (-120_000, 150_000)),
        ((0, 0), (-132_768, 232_768)),
        ((300_000, 400_000), (-132_768, 232_768)),
    ],
)
def test_the_drives_own_limits_are_never_widened_unless_they_are_none(bus, slave, generic, own, new):
    slave.values[0x607D, 1], slave.values[0x607D, 2] = own
    ready(bus, allowing(generic, 0x607D), position_limit_rad=LIMIT_RAD).close()
    assert held(slave) == new


def test_a_later_run_with_wider_limits_gets_them_as_far_as_the_drive_was_found_with(bus, slave, generic, tmp_path):
    options = GroupOptions(ledger_path=tmp_path / "ledger.json")
    profile = allowing(generic, 0x607D)
    ready(bus, profile, options, position_limit_rad=(-100 * COUNT_RAD, 2000 * COUNT_RAD)).close()
    ready(bus, profile, options, position_limit_rad=LIMIT_RAD).close()
    assert held(slave) == (-100_000 - TURN // 2, 200_000 + TURN // 2)
    ready(bus, profile, options, position_limit_rad=(-20.0 * math.tau, 20.0 * math.tau)).close()
    assert held(slave) == (-400_000, 400_000)


def test_limits_stay_in_order_at_every_step(bus, slave, generic):
    """A drive may abort a minimum above its maximum, 0x06090036; 0 and 0 mean none."""
    slave.position = 900_000
    slave.values[0x607D, 1] = slave.values[0x607D, 2] = 0

    def strict(address, data):
        above = address == (0x607D, 1) and int.from_bytes(data, "little", signed=True) > held(slave)[1]
        return 0x06090036 if above else 0

    slave.refuses_write = strict
    limit_rad = (800_000 * COUNT_RAD, 1_000_000 * COUNT_RAD)
    ready(bus, allowing(generic, 0x607D), position_limit_rad=limit_rad).close()
    assert held(slave) == (800_000 - TURN // 2, 1_000_000 + TURN // 2)


@pytest.mark.parametrize("case", ["not allowed", "home offset", "reversed", "outside", "no limit", "absent"])
def test_what_is_not_certain_is_left_alone(bus, slave, generic, case):
    profile = generic if case == "not allowed" else allowing(generic, 0x607D)
    if case == "home offset":
        slave.types[0x607C, 0], slave.values[0x607C, 0] = "i32", 7
    elif case == "reversed":
        slave.types[0x607E, 0], slave.values[0x607E, 0] = "u8", 0x80
    elif case == "outside":
        slave.position = 300_000
    elif case == "absent":
        slave.refused[0x607D, 1] = 0x06020000
    ready(bus, profile, position_limit_rad=None if case == "no limit" else LIMIT_RAD).close()
    assert held(slave) == (-400_000, 400_000)


# -- 0x6072 -----------------------------------------------------------------------------------------------------------


def test_the_torque_limit_is_lowered_to_the_next_per_mille_and_restored(bus, slave, generic):
    with ready(bus, generic, torque_limit_nm=1.2341) as group:
        assert slave.values[0x6072, 0] == math.ceil(1.2341 / RATED_NM * 1000) == 618
        group.restore()
    assert slave.values[0x6072, 0] == 3000


@pytest.mark.parametrize(
    ("limit_nm", "allowed", "after"), [(6.1, True, 3000), (None, True, 3000), (1.0, False, 3000), (6.0, True, 3000)]
)
def test_the_torque_limit_is_never_raised(bus, slave, generic, limit_nm, allowed, after):
    profile = generic if allowed else allowing(generic, without=(0x6072,))
    ready(bus, profile, torque_limit_nm=limit_nm).close()
    assert slave.values[0x6072, 0] == after


@pytest.mark.parametrize(
    ("address", "step", "after"),
    [
        ((0x607D, 1), 1000, -32000),
        ((0x6072, 0), -50, 650),
        ((0x1017, 0), 8, 96),
        ((0x1016, 1), 7, (127 << 16 | 500) // 7 * 7),
    ],
)
def test_a_drive_may_round_what_is_written(bus, slave, generic, address, step, after):
    slave.rounded = {address: step}
    limits = {"position_limit_rad": (1000 * COUNT_RAD, 1100 * COUNT_RAD), "torque_limit_nm": 1.2341}
    with ready(bus, allowing(generic, 0x607D), **limits) as group:
        group.enable()
        assert slave.values[address] == after


@pytest.mark.parametrize(
    ("address", "step"),
    [((0x607D, 1), 200_000), ((0x6072, 0), 100), ((0x6072, 0), -100), ((0x1017, 0), 60), ((0x1016, 1), 300)],
)
def test_a_drive_that_keeps_another_value_than_a_rounded_one_is_refused(bus, slave, generic, address, step):
    slave.rounded = {address: step}
    limits, refused = {"position_limit_rad": (0.0, 0.1), "torque_limit_nm": 1.2341}, f"{address[0]:04X}"
    with pytest.raises(ConfigurationRefused, match=refused), ready(bus, allowing(generic, 0x607D), **limits) as group:
        group.enable()


def test_a_later_run_may_need_more_but_never_more_than_was_found(bus, slave, generic, tmp_path):
    options = GroupOptions(ledger_path=tmp_path / "ledger.json")
    for limit_nm, after in ((1.0, 500), (2.0, 1000), (8.0, 3000), (1.0, 500), (None, 3000)):
        ready(bus, generic, options, torque_limit_nm=limit_nm).close()
        assert slave.values[0x6072, 0] == after


def test_the_torque_limit_does_not_change_under_power(bus, slave, generic):
    with ready(bus, generic) as group:
        (drive,) = group.drives
        for permille, after in ((2000, 2000), (3001, 3000)):
            limit_torque(drive.access, permille)
            assert slave.values[0x6072, 0] == after
        group.enable()
        with pytest.raises(DriveFault, match="only while it is disabled"):
            limit_torque(drive.access, 1000)
        group.disable()
        limit_torque(drive.access, 1000)
    assert slave.values[0x6072, 0] == 1000


def test_a_drive_that_measures_current_has_no_rated_torque_to_count_in(bus, slave):
    slave.values[0x1018, 1] = 0x6A
    profile = allowing(load_profile("kollmorgen-akd-x00606"), 0x6072)
    ready(bus, profile, torque_limit_nm=0.1).close()
    assert slave.values[0x6072, 0] == 3000


@pytest.mark.parametrize("limit_nm", [0.0, -1.0, math.nan, math.inf])
def test_a_torque_limit_that_is_none_is_refused(generic, limit_nm):
    with pytest.raises(ProfileError, match="torque_limit_nm"):
        AxisSetup(1, generic, 0.5, 300.0, torque_limit_nm=limit_nm)
