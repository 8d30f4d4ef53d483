"""What the master makes of the words of a fake that counts as its make does, and that a wrong profile shows."""

from __future__ import annotations

import math
import struct
import tomllib
import uuid
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from drives.profile import CountsFromObjects
from drives.profile_file import PROFILE_FOLDER, parse_profile
from drives.scaling import Constants, motor_scale
from sim.faults import KINDS, act, fault_of
from sim.makes import MAKES, QUIRKS, draw_make
from sim.serve import running
from sim.units import drive_units
from tests.sim.conftest import SMALL

KT = 1.81


def shown(units, rated):
    """What a rated value comes to, read from the fake."""
    if rated is None or rated.object is None:
        return None if rated is None else rated.value
    return units.constants[rated.object.index, rated.object.subindex][1] * rated.unit


def read_back(axis, text):
    """Torque, current, velocity and position that the master reads, as parts of the true ones."""
    profile = parse_profile(text, "mine.toml")
    units = drive_units(replace(axis, profile=tomllib.loads(text)))
    counts = profile.position.counts_per_revolution
    if isinstance(counts, CountsFromObjects):
        turn = units.constants[counts.object.index, counts.object.subindex][1]
        turn /= 1 if counts.per is None else units.constants[counts.per.index, counts.per.subindex][1]
    else:
        turn = counts.value
    current = None if profile.current is None else shown(units, profile.current.rated)
    scale = motor_scale(profile, Constants(shown(units, profile.torque.rated), current, None, turn), KT)
    parts = {
        "torque": scale.torque_nm * units.torque.bits_per_unit,
        "position": scale.count_rad * units.counts_per_rad,
    }
    if scale.velocity_rad_s is not None:
        parts["velocity"] = scale.velocity_rad_s * units.velocity.bits_per_unit
    if scale.current_a is not None:
        parts["current"] = scale.current_a * KT * units.current.bits_per_unit
    assert (profile.torque.object.index, profile.torque.object.subindex) == units.torque.address
    return parts


@pytest.fixture
def axis(arm_of):
    """Axis 2 of the large arm: 1.81 Nm/A, rated 23.875 Nm."""
    return arm_of("large").axes[1]


@pytest.mark.parametrize("name", sorted(MAKES))
def test_the_master_reads_what_is_true(name, axis):
    parts = read_back(axis, (PROFILE_FOLDER / f"{name}.toml").read_text())
    assert parts == pytest.approx(dict.fromkeys(parts, 1.0), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "old", "new", "quantity", "factor"),
    [
        ("maxon-epos4", "unit = 0.000001", "unit = 0.001", "torque", 1000.0),
        ("elmo-gold", "unit = 0.001", "unit = 0.000001", "torque", 1e-3),
        ("novanta-emcl", 'current_reference = "peak"', 'current_reference = "rms"', "current", math.sqrt(2.0)),
        ("kinco-fd123", 'current_reference = "rms"', 'current_reference = "peak"', "torque", math.sqrt(0.5)),
        ("kinco-fd123", "value = 0.06103515625", "value = 0.06", "velocity", 0.06 / 0.06103515625),
        ("kollmorgen-akd-x00606", "value = 6.0", "value = 3.0", "torque", 0.5),
        ("technosoft-ipos8010", "value = 0.0006105006105006105", "value = 0.000305", "torque", 0.000305 * 1638.0),
    ],
)
def test_a_profile_that_says_otherwise_than_the_make_shows(name, old, new, quantity, factor, axis):
    text = (PROFILE_FOLDER / f"{name}.toml").read_text()
    assert old in text
    assert read_back(axis, text.replace(old, new, 1))[quantity] == pytest.approx(factor, rel=1e-3)


ROWS = [(name, row) for name, rows in QUIRKS.items() for row in rows]


@pytest.mark.parametrize(("name", "row"), ROWS, ids=[f"{name} {row.kind}" for name, row in ROWS])
def test_a_make_consists_of_rows_of_the_table_of_faults(name, row):
    about = KINDS[row.kind]
    given = {key: getattr(row, key) for key in about.defaults} | {"subindex": row.subindex if row.index else 0}
    given = given if "index" in about.defaults else {key: given[key] for key in about.defaults}
    assert fault_of(row.kind, **given) == row
    assert about.reaction in ("goes on", "refuses", "stops")


@pytest.fixture
def make_of(tmp_path, master_on):
    """Master and drives of a cell whose profiles have the name of a make, or that have the rows of a drawn one."""
    with ExitStack() as stack:

        def build(name, rows=()):
            profile = (PROFILE_FOLDER / "generic-cia402.toml").read_text()
            assert 'name = "generic-cia402"' in profile
            (tmp_path / "make.toml").write_text(profile.replace('name = "generic-cia402"', f'name = "{name}"', 1))
            cell = (SMALL.read_text()).replace('profile = "generic-cia402"', 'profile = "make.toml"')
            for part in SMALL.parent.iterdir():
                if part.name != "cell.toml":
                    (tmp_path / part.name).symlink_to(part)
            (tmp_path / "cell.toml").write_text(cell)
            channel = f"make-{uuid.uuid4().hex}"
            simulation = stack.enter_context(
                running(tmp_path / "cell.toml", f"virtual:{channel}", pacing="lockstep", noise_seed=1)
            )
            drives = simulation.simulation.servers[0].drives
            for row in rows:
                act(drives, row)
            return master_on(channel), drives

        yield build


def aborts(master, index, sub=0, write=None):
    with pytest.raises(master.Aborted) as caught:
        master.read(2, index, sub) if write is None else master.write(2, index, sub, *write)
    return caught.value.code


@pytest.mark.parametrize("name", QUIRKS)
def test_a_drive_of_a_make_answers_and_is_put_right_to_its_make(name, make_of):
    master, drives = make_of(name)
    assert master.number(2, 0x6041) & 0x6F == 0x40
    values = {sub: master.number(2, 0x60C2, sub) for sub in (1, 2)}
    drives[1].repair()
    assert {sub: master.number(2, 0x60C2, sub) for sub in (1, 2)} == values
    for row in QUIRKS[name]:
        if row.kind == "object_absent":
            assert aborts(master, row.index) == row.code


def test_a_pilz_has_mode_7_alone_and_stops_without_0x6007(make_of):
    master, _ = make_of("pilz-prbt")
    assert master.number(2, 0x6502) == 0x43
    assert aborts(master, 0x6060, 0, (8, 1)) == 0x06090030
    master.write(2, 0x6060, 0, 7, 1)
    assert master.number(2, 0x60C2, 1) == 8
    assert aborts(master, 0x6007) == 0x06020000
    master.configure(2, 7)
    master.map(2, 0, (0x60400010, 0x60C10120), 1, receive=True)
    master.write(2, 0x1016, 1, 0x7F << 16 | 50, 4)
    master.send(0x77F, b"\x05")
    position = master.number(2, 0x6064, signed=True)
    states = set()
    for word in (0x06, 0x07, *[0x0F] * 40):
        master.send(0x202, struct.pack("<Hi", word, position))
        master.send(0x080, b"")
        states.add(struct.unpack_from("<H", master.wait(0x182))[0] & 0x6F)
    assert 0x27 in states
    assert master.number(2, 0x6041) & 0x6F == 0x40


def test_objects_of_makes_are_as_stated(make_of):
    master, _ = make_of(
        "none",
        [
            fault_of("object_range", index=0x60C2, subindex=1, low=1, high=20),
            fault_of("object_value", index=0x607A, code=4000),
            fault_of("object_value", index=0x6072, code=100),
            fault_of("object_value", index=0x1401, subindex=1, code=0x3F5),
            fault_of("object_read_only", index=0x1400, subindex=2),
            fault_of("object_size", index=0x60B2, code=4),
            fault_of("object_rounded", index=0x6083, code=10),
            fault_of("record_short", index=0x1800, code=3),
            fault_of("object_not_mappable", index=0x60B1),
            fault_of("status_bits_on", code=1 << 11),
            fault_of("mode_display_late"),
            fault_of("mapping_locked"),
        ],
    )
    assert aborts(master, 0x60C2, 1, (21, 1)) == 0x06090031
    assert aborts(master, 0x60C2, 1, (0, 1)) == 0x06090032
    for _ in range(2):
        assert master.number(2, 0x607A) == 4000
        assert master.number(2, 0x6072) == 100
        assert master.number(2, 0x1401, 1) == 0x3F5
        master.send(0x000, bytes([129, 2]))
        master.wait(0x702)
    assert aborts(master, 0x1400, 2, (1, 1)) == 0x06010002
    assert len(master.read(2, 0x60B2)) == 4
    master.write(2, 0x6083, 0, 1234, 4)
    assert master.number(2, 0x6083) == 1230
    assert master.number(2, 0x1800) == 3
    assert aborts(master, 0x1800, 5) == 0x06090011
    master.write(2, 0x1A01, 0, 0, 1)
    assert aborts(master, 0x1A01, 1, (0x60B10020, 4)) == 0x06040041
    assert master.number(2, 0x6041) & 1 << 11
    master.write(2, 0x6060, 0, 8, 1)
    assert master.number(2, 0x6061) == 0
    master.send(0x000, bytes([1, 2]))
    assert aborts(master, 0x1A01, 1, (0x60640020, 4)) == 0x08000022


def test_a_period_acts_once_both_subindices_were_written(make_of):
    master, drives = make_of("none", [fault_of("period_pair")])
    master.write(2, 0x60C2, 1, 20, 1)
    assert drives[1].motion.period_s() == pytest.approx(0.01)
    master.write(2, 0x60C2, 2, -3, 1)
    assert drives[1].motion.period_s() == pytest.approx(0.02)


def test_a_slow_drive_takes_its_time_to_enable_and_none_to_stop(make_of):
    master, _ = make_of("none", [fault_of("slow_enable", delay_s=0.2)])
    master.configure(2, 8)
    position = master.number(2, 0x6064, signed=True)
    waited = {}
    for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27), (0x00, 0x40)):
        waited[word] = next(n for n in range(50) if master.cycle(2, word, position)[0] & 0x6F == state)
    assert all(19 <= waited[word] <= 23 for word in (0x06, 0x07, 0x0F))
    assert waited[0x00] <= 1


def test_warnings_wraps_and_a_sync_producer(make_of):
    master, _ = make_of(
        "none", [fault_of("warning_emcy", count=5), fault_of("position_wraps"), fault_of("sync_producer")]
    )
    master.configure(2, 8)
    master.map(2, 0, (0x60400010,), 1, receive=True)
    for word in (0x06, 0x07, *[0x0F] * 20):
        master.send(0x202, struct.pack("<H", word))
        master.send(0x080, b"")
        status, position, _ = struct.unpack("<Hih", master.wait(0x182))
        assert -0x8000 <= position < 0x8000
    assert status & 0x6F == 0x27
    seen = [frame for frame in master.drain() if frame.arbitration_id in (0x80, 0x82)]
    assert [bytes(frame.data[:2]) for frame in seen if frame.arbitration_id == 0x82] == [b"\x10\x43"]
    assert [frame for frame in seen if frame.arbitration_id == 0x80]


def test_makes_are_drawn_by_their_seed():
    makes = [draw_make(seed) for seed in range(200)]
    assert makes == [draw_make(seed) for seed in range(200)]
    assert 20 <= sum(not can_move for _, can_move in makes) <= 60
    assert {row.kind for rows, _ in makes for row in rows} >= {"object_absent", "period_pair", "slow_enable"}


@pytest.mark.parametrize("seed", range(6))
def test_a_drawn_make_is_served_and_says_whether_it_can_move(seed, make_of):
    rows, can_move = draw_make(seed)
    master, _ = make_of("none", rows)
    lacking = {row.index for row in rows if row.kind == "object_absent"}
    assert can_move == lacking.isdisjoint({0x6040, 0x6041, 0x6060, 0x6064})
    assert all(aborts(master, index) for index in lacking)


def test_every_make_has_its_profile():
    assert all(Path(PROFILE_FOLDER, f"{name}.toml").is_file() for name in MAKES)
