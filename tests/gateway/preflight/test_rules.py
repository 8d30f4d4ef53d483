"""Rules of the pre-flight check, on readings written down by hand."""

import math
import re
import shutil

import pytest

from drives.instrument import InstrumentSetup
from drives.objects import OBJECTS
from drives.profile_file import load_profile, parse_profile
from drives.values import Identity
from gateway.acquire.planning import make_plan
from gateway.cell.config import ArmConfig, BusConfig, LoadedCell
from gateway.errors import PlanRefused
from gateway.excite.planning import MovingRequest, make_moving_plan
from gateway.preflight.drive_check import addresses, judge_bus_load, live_addresses
from gateway.preflight.rules import Axis, judge_identity, judge_place, judge_ranges, judge_settings, judge_state
from tests.data.axes import axis_table

PROFILE = load_profile("generic-cia402")
COUNTS = 65536
GOOD = {
    "statusword": 0x0640,
    "max_torque": 3000,
    "position": 0,
    "position_limit_min": 0,
    "position_limit_max": 0,
    "polarity": 0,
    "encoder_increments": COUNTS,
    "encoder_revolutions": 1,
    "gear_motor_revolutions": 1,
    "gear_shaft_revolutions": 1,
    "torque_offset": 0,
    "abort_connection_option": 1,
    "consumer_heartbeat": 0,
    "supported_modes": 0x3ED,
    "rated_torque": 1270,
    "torque": 12,
}


def judge_axis(axis, readings):
    return [*judge_state(axis, readings), *judge_settings(axis, readings)]


def judge_limits(axis, arm, readings):
    return [*judge_place(axis, arm, readings), *judge_ranges(axis, arm, readings)]


def arm(**changes):
    axes = [axis_table(joint, **(changes if joint == 1 else {})) for joint in range(1, 7)]
    return ArmConfig.model_validate({"name": "main", "bus": "a", "robot": "r.urdf", "axis": axes})


def axis(config=None, profile=PROFILE):
    return Axis(1, (config or arm()).axis[0], profile)


def readings(**changes):
    return {OBJECTS[name].address: value for name, value in (GOOD | changes).items()}


def worst(items):
    return [item for item in items if item.severity == "fail"]


def test_a_healthy_drive_passes_every_rule():
    items = judge_axis(axis(), readings())
    assert not [item for item in items if item.severity in ("warn", "fail")]
    assert not worst(judge_limits(axis(), arm(), readings()))


@pytest.mark.parametrize(
    ("changes", "severity", "says"),
    [
        ({"statusword": 0x0008}, "fail", "FAULT"),
        ({"statusword": 0x0637}, "fail", "OPERATION ENABLED"),
        ({"statusword": 0x0617}, "fail", "QUICK STOP ACTIVE"),
        ({"statusword": 0x0633}, "warn", "SWITCHED ON"),
        ({"statusword": None}, "fail", "no statusword"),
        ({"supported_modes": 0x2D}, "fail", "no cyclic synchronous position"),
        ({"rated_torque": 0}, "fail", "all torques would be zero"),
        ({"rated_torque": None}, "fail", "missing"),
        ({"torque": None}, "fail", "does not have the torque object"),
        ({"max_torque": 0}, "fail", "produces no torque"),
        ({"rated_torque": 1_270_000}, "fail", "another unit"),
        ({"max_torque": 100}, "fail", "too little"),
        ({"mode": None}, "fail", "the EDS of this firmware"),
        ({"statusword": 0x0E40}, "warn", "ignored_status = 0x0800"),
        ({"max_torque": 500}, "warn", "64 Nm at the joint"),  # 0.5 of 1.27 Nm over a ratio of 100
        ({"polarity": 0xC0}, "fail", "inverts position"),
        ({"gear_motor_revolutions": 100}, "fail", "applies a gear ratio"),
        ({"feed_constant_feed": 360_000, "feed_constant_revolutions": 1}, "fail", "by a feed constant"),
        ({"position_offset": -5}, "fail", "added to every target"),
        ({"positive_torque_limit": 0}, "fail", "produces no torque"),
        ({"negative_torque_limit": 500}, "warn", "64 Nm at the joint"),
        ({"max_current": 0}, "fail", "produces no torque"),
        ({"max_current": 500, "rated_current": 4000}, "warn", "62 Nm at the joint"),
        ({"encoder_increments": 0}, "fail", "encoder resolution"),
        ({"encoder_increments": 1}, "fail", "encoder resolution"),
        ({"torque_offset": 30}, "warn", "torque offset is active"),
        ({"consumer_heartbeat": None}, "fail", "loss of the master"),
        ({"abort_connection_option": None}, "fail", "loss of the master"),
    ],
)
def test_each_rule_says_what_is_wrong_and_what_to_do(changes, severity, says):
    items = [item for item in judge_axis(axis(), readings(**changes)) if item.severity == severity]
    assert any(says in f"{item.what} {item.advice}" for item in items)
    assert all(item.advice for item in items)
    assert all(item.where.startswith("J1 node 1") for item in items)


@pytest.mark.parametrize(
    "changes",
    [
        {"feed_constant_feed": 1, "feed_constant_revolutions": 1},
        {"feed_constant_feed": COUNTS, "feed_constant_revolutions": 1},
        {"feed_constant_feed": None, "feed_constant_revolutions": None},
        {"position_offset": 0},
        {"positive_torque_limit": 3000, "negative_torque_limit": 3000},
        # 0.31 Nm/A, 4 A, ratio 100: 1000 per mille are 124 Nm, the cell allows 200
        {"max_current": 1700, "rated_current": 4000},
        {"max_current": 1700},
    ],
)
def test_settings_that_are_in_order_say_nothing(changes):
    assert not [item for item in judge_axis(axis(), readings(**changes)) if item.severity in ("warn", "fail")]


def test_the_state_is_apart_from_the_settings_since_enabling_refuses_it_in_words_of_its_own():
    found = readings(statusword=0x0008, rated_torque=0, polarity=0xC0)
    assert [item.where.split(" (")[1] for item in worst(judge_state(axis(), found))] == ["statusword)", "rated_torque)"]
    assert [item.where.split(" (")[1] for item in worst(judge_settings(axis(), found))] == ["polarity)"]


def test_unreported_modes_are_no_failure():
    assert not worst(judge_axis(axis(), readings(supported_modes=None)))


@pytest.mark.parametrize("nature", ["demand", "unknown"])
def test_a_torque_that_is_not_measured_is_refused(nature):
    text = PROFILE.text.replace('nature = "measured"', f'nature = "{nature}"', 1)
    found = worst(judge_axis(axis(profile=parse_profile(text, "p.toml")), readings()))
    assert any(nature in item.what and "cannot be estimated" in item.what for item in found)


STO = """[[safety]]
what = "safe torque off"
object = { index = 0x60FD, type = "u32" }
mask = 0x00030000
good = 0x00010000
[reference]
object = { index = 0x2010, type = "u16" }
mask = 1
good = 1
[torque_offset]
kind = "permille_rated_torque"
rated = { object = { index = 0x2076, type = "u32" }, unit = 0.001, source = "manual" }
source = "manual"
[[emcy]]
"""


@pytest.mark.parametrize(
    ("inputs", "referenced", "says"),
    [
        (0xFF01_0000, 1, []),
        (0xFF03_0000, 1, ["safe torque off"]),
        (0, 0, ["safe torque off", "not referenced"]),
        (None, 1, ["does not have this status object"]),
    ],
)
def test_safety_chain_and_reference_where_the_profile_names_them(inputs, referenced, says):
    text = "".join(line for line in PROFILE.text.splitlines(keepends=True) if not line.startswith("eds ="))
    profile = parse_profile(text.replace("[[emcy]]\n", STO, 1), "p.toml")
    found = readings() | {(0x60FD, 0): inputs, (0x2010, 0): referenced}
    failing = worst(judge_state(axis(profile=profile), found))
    assert len(failing) == len(says)
    assert all(text in item.what and item.advice for text, item in zip(says, failing, strict=True))
    assert {(0x60FD, 0), (0x2010, 0), (0x2076, 0)} <= addresses(profile).keys()
    assert {(0x60FD, 0), (0x2010, 0)} <= live_addresses(profile)


@pytest.mark.parametrize("name", ["nanotec", "technosoft-ipos8010"])
def test_a_torque_limit_of_zero_is_refused_where_the_torque_is_scaled_as_a_current(name):
    items = worst(judge_settings(axis(profile=load_profile(name)), readings(max_torque=0)))
    assert any("max_torque" in item.where and "no torque" in item.what for item in items)


def test_a_torque_limit_that_holds_no_arm_is_refused_where_the_torque_is_a_current():
    items = judge_settings(axis(profile=load_profile("nanotec")), readings(max_torque=100) | {(0x203B, 1): 4000})
    assert any("max_torque" in item.where and "too little" in item.what for item in worst(items))


def identity(**changes):
    values = {
        "node_id": 1,
        "device_type": 0x00020192,
        "vendor_id": 2,
        "product_code": 7,
        "revision": 0x10000,
        "serial_number": 5,
        "name": "drive",
        "hardware_version": "1",
        "software_version": "2.3",
    }
    return Identity(**(values | changes))


def test_identity_against_the_profile():
    elmo = load_profile("elmo-gold")
    assert not worst(judge_identity(axis(profile=elmo), identity(vendor_id=0x9A)))
    wrong = worst(judge_identity(axis(profile=elmo), identity(vendor_id=9)))
    assert len(wrong) == 1
    assert "vendor id" in wrong[0].what
    assert worst(judge_identity(axis(), identity(device_type=0x00030191)))
    assert "firmware 2.3" in judge_identity(axis(), identity())[-1].what


def test_position_of_the_joint():
    # q = p / N: 1.5 rad at the joint is 150 rad at the motor
    counts = round(150 / (2 * math.pi) * COUNTS)
    assert not worst(judge_limits(axis(), arm(), readings(position=counts)))
    outside = worst(judge_limits(axis(), arm(), readings(position=2 * counts)))
    assert "3.000 rad" in outside[0].what


def test_position_of_the_joint_with_sign_and_offset():
    config = arm(position_sign=-1, zero_offset_rad=0.25)
    counts = round(100 / (2 * math.pi) * COUNTS)
    item = judge_limits(axis(config), config, readings(position=counts))[0]
    assert "is at -0.750 rad" in item.what


def test_software_limits_narrower_than_the_cell_fail():
    end = round(150 / (2 * math.pi) * COUNTS)
    narrow = worst(judge_limits(axis(), arm(), readings(position_limit_min=-end, position_limit_max=end)))
    assert "drive -1.500 to 1.500 rad" in narrow[0].what
    wide = judge_limits(axis(), arm(), readings(position_limit_min=-2 * end, position_limit_max=2 * end))
    assert not worst(wide)


def test_a_position_range_that_ends_inside_the_cells_limits_fails():
    """0x607B: at its end the position jumps by the whole range."""
    end = round(150 / (2 * math.pi) * COUNTS)
    narrow = worst(judge_limits(axis(), arm(), readings(position_range_min=-end, position_range_max=end)))
    assert "drive -1.500 to 1.500 rad" in narrow[0].what
    assert "607B:01" in narrow[0].where
    wide = readings(position_range_min=-(2**31), position_range_max=2**31 - 1)
    assert not worst(judge_limits(axis(), arm(), wide))
    assert not worst(judge_limits(axis(), arm(), readings(position_range_min=0, position_range_max=0)))


@pytest.mark.parametrize(("joint_rad", "severity"), [(0.1, "ok"), (0.39, "ok"), (0.41, "warn"), (0.0, "warn")])
def test_following_error_window_against_four_times_the_cells(joint_rad, severity):
    window = round(100 * joint_rad / (2 * math.pi) * COUNTS)
    items = judge_limits(axis(), arm(), readings(following_error_window=window))
    (item,) = [item for item in items if "following_error_window" in item.where]
    assert item.severity == severity


@pytest.mark.parametrize(
    ("period_s", "pacing", "severity", "percent"),
    [(0.004, "real", "ok", 56), (0.002, "real", "fail", 112), (0.002, "lockstep", "warn", 112)],
)
def test_bus_load_of_six_drives_with_two_tpdos_each(period_s, pacing, severity, percent):
    # SYNC 55 bits, 18 frames of 8 bytes or 6: 6 x (RPDO 6 B 115 + TPDO1 8 B 135 + TPDO2 6 B 115) + 55 = 2245 bits
    config = BusConfig(interface="virtual", channel="c", sync_period_s=period_s, pacing=pacing)
    item = judge_bus_load(config, [(node, PROFILE) for node in range(1, 7)])
    assert item.severity == severity
    bits = 6 * (115 + 135 + 115) + 55
    assert f"planned {100 * bits / (period_s * 1e6):.0f} %" in item.what
    assert abs(100 * bits / (period_s * 1e6) - percent) < 6
    assert bool(item.advice) == (severity != "ok")


def test_bus_load_counts_a_measuring_device():
    """Six values of 32 bits in three frames of 8 bytes, six status bytes in one of 6: 3 x 135 + 115 bits."""
    config = BusConfig(interface="virtual", channel="c", sync_period_s=0.0038, pacing="real")
    device = InstrumentSetup(20, 0x9130, "i32", (1, 2, 3, 4, 5, 6), 1e-6, status_index=0x6150)
    item = judge_bus_load(config, [(node, PROFILE) for node in range(1, 7)], [device])
    bits = 6 * (115 + 135 + 115) + 55 + 3 * 135 + 115
    assert f"planned {100 * bits / 3800:.0f} %" in item.what
    assert item.severity == "fail"


#: The profile without a word of what its arithmetic rests upon.
WITHOUT_BASIS = PROFILE.text.replace('basis = "standard"\n', "")
TORQUE_SOURCE, RATED_SOURCE = 'source = "CiA 402-2, 0x6077; filter assumed"', 'source = "CiA 402-2, 0x6076 in mNm"'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (TORQUE_SOURCE, 'source = "assumed"', "0x6077:00"),
        (RATED_SOURCE, 'source = "Assumed: mNm"', "0x6077:00"),
        ("[torque]", '[torque]\nbasis = "assumed"', "0x6077:00"),
        ("name = ", 'no_motion = ["no brake"]\nname = ', "no brake"),
    ],
)
def test_a_profile_that_reads_and_does_not_move_fails_by_name(old, new, says):
    profile = parse_profile(WITHOUT_BASIS.replace(old, new, 1), "p.toml")
    (found,) = worst(judge_settings(axis(profile=profile), readings()))
    assert "refuses motion" in found.what
    assert says in found.what
    assert found.advice


def test_a_basis_that_is_stated_goes_before_the_words_of_the_source():
    text = WITHOUT_BASIS.replace(TORQUE_SOURCE, 'source = "assumed"')
    assert parse_profile(text, "p.toml").obstacles
    assert parse_profile(text.replace("[torque]", '[torque]\nbasis = "measured"', 1), "p.toml").obstacles == ()
    assert parse_profile(WITHOUT_BASIS, "p.toml").obstacles == ()


def test_a_resolution_that_one_object_holds_is_of_one_revolution():
    profile = parse_profile(IGNORES_TURNS, "p.toml")
    assert (0x608F, 2) in addresses(PROFILE)
    assert not worst(judge_axis(axis(profile=profile), readings(encoder_revolutions=None)))
    assert worst(judge_axis(axis(), readings(encoder_revolutions=None)))


IGNORES_TURNS = PROFILE.text.replace(', per = { index = 0x608F, subindex = 2, type = "u32" }', "")
CONSTANT_COUNTS = re.sub(
    r"counts_per_revolution = .*", 'counts_per_revolution = { value = 16384, source = "manual" }', PROFILE.text
)


@pytest.mark.parametrize(
    ("text", "turns", "severity"),
    [
        (PROFILE.text, 4, None),
        (IGNORES_TURNS, 1, None),
        (IGNORES_TURNS, 4, "fail"),
        (CONSTANT_COUNTS, 4, None),
        (CONSTANT_COUNTS, 3, "fail"),
        (CONSTANT_COUNTS, 1, "warn"),
    ],
)
def test_an_encoder_resolution_over_several_revolutions_is_used_by_the_profile_or_refused(text, turns, severity):
    """65536 counts in 4 revolutions are 16384 in one: a profile that reads 65536 moves every joint 4 times as far."""
    profile = parse_profile(text, "p.toml")
    found = [
        item
        for item in judge_settings(axis(profile=profile), readings(encoder_revolutions=turns))
        if ":608F:" in item.where
    ]
    assert [item.severity for item in found] == ([] if severity is None else [severity])
    assert all(item.advice for item in found)


HIGH_RESOLUTION = 1 << 26


@pytest.mark.parametrize("limit_rad", [[-2.0, 1.0], [-1.0, 2.0]])
def test_positions_that_leave_32_bits_inside_the_joint_limits_are_refused(limit_rad):
    config = arm(position_limit_rad=limit_rad, gear_ratio={"value": 120, "source": "datasheet"})
    items = judge_limits(axis(config), config, readings(encoder_increments=HIGH_RESOLUTION))
    found = next(item for item in worst(items) if "607A:00" in item.where)
    assert re.search(r"J1 at -?2\.000 rad is at -?2563369\d\d\d counts.*-1\.676 to 1\.676 rad", found.what)
    assert "position_limit_rad" in found.advice


def test_positions_that_fit_32_bits_are_not_refused():
    config = arm(position_limit_rad=[-1.6, 1.6], gear_ratio={"value": 120, "source": "datasheet"})
    items = judge_limits(axis(config), config, readings(encoder_increments=HIGH_RESOLUTION))
    assert not [item for item in worst(items) if "607A:00" in item.where]


def test_a_motor_that_coupled_joints_drive_beyond_32_bits_is_refused():
    config = arm(position_limit_rad=[-1.0, 1.0], gear_ratio={"value": 120, "source": "datasheet"})
    mixed = [[1.0 if row == column else 0.0 for column in range(6)] for row in range(6)]
    mixed[0][1] = 0.5
    config = config.model_copy(update={"coupling": tuple(map(tuple, mixed))})
    items = judge_limits(axis(config), config, readings(encoder_increments=HIGH_RESOLUTION))
    assert "coupled joints" in next(item for item in worst(items) if "607A:00" in item.where).what


@pytest.mark.parametrize("planned", [make_plan, lambda loaded: make_moving_plan(loaded, None, MovingRequest())])
def test_a_plan_that_would_leave_32_bits_is_refused_where_the_profile_gives_the_resolution(
    small_cell, tmp_path, planned
):
    config = small_cell.cell.arm[0]
    text = PROFILE.text.replace('eds = "generic-cia402.eds"\n', "")
    text = re.sub(
        r"(?m)^counts_per_revolution = .*$", f'counts_per_revolution = {{ value = {1 << 26}, source = "sheet" }}', text
    )
    (tmp_path / "fine.toml").write_text(text)
    shutil.copy(small_cell.folder / config.robot, tmp_path / config.robot)
    axes = (config.axis[0], config.axis[1].model_copy(update={"profile": "fine"}), *config.axis[2:])
    cell = small_cell.cell.model_copy(update={"arm": (config.model_copy(update={"axis": axes}),)})
    loaded = LoadedCell(cell=cell, text=small_cell.text, folder=tmp_path)
    with pytest.raises(PlanRefused, match=r"J2 node 2: J2 at -?\d\.\d+ rad is at -?\d{10,} counts.*32 bits"):
        planned(loaded)
