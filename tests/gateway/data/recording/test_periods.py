"""Periods of a recording: what goes in comes out as moving rows, what is broken is refused in a sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from drives.profile_file import load_profile
from drives.scaling import motor_scale
from gateway.cell.config import LoadedCell, load_cell, parse_cell
from gateway.cell.conversion import AxisConversion
from gateway.data.period import Period, motion_number
from gateway.data.recording.binding import bind
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import RecordingWriter
from gateway.data.table import read_csv, write_csv
from gateway.data.visit import NO_WORD
from gateway.errors import InputError
from gateway.excite.excitation import Series, fingerprint
from tests.data.excitations import HOME_RAD
from tests.data.visits import ARM_HEADER, CONSTANTS, header_of, recording_of, visit

SYNC_S, N = 0.004, 500
SERIES = Series("load", HOME_RAD, np.outer(np.ones(6), [0.4, -0.1, 0.0]), np.zeros((6, 3)), N * SYNC_S, 2)


@pytest.fixture(scope="module")
def cell() -> LoadedCell:
    return load_cell(Path(__file__).parents[4] / "examples" / "small" / "cell.toml")


def period(number: int, load: str = "none", start: int = 100, complete: bool = True) -> Period:
    """A period that was followed exactly; the torques are random words."""
    random = np.random.default_rng([number, start])
    scale = motor_scale(load_profile("generic-cia402"), CONSTANTS, 1.0)
    axes = AxisConversion.from_arm(load_cell(Path("examples/small/cell.toml")).cell.arm[0])
    words = random.integers(-400, 400, (N, 6))
    at = SERIES.at(np.arange(N) * SYNC_S)[0]
    motor = words * scale.torque_nm
    absent = np.full((N, 6), NO_WORD)
    full_period = Period(
        number=0,
        load=load,
        excitation=fingerprint(SERIES),
        name="load",
        kind="series",
        joint=0,
        period=number,
        speed=1.0,
        period_s=N * SYNC_S,
        complete=complete,
        incomplete_epochs=0 if complete else 1,
        target_rad=at,
        statusword=np.full((N, 6), 0x1237),
        position_count=np.zeros((N, 6), dtype=np.int64),
        torque_word=words,
        current_word=absent,
        velocity_word=absent,
        q_rad=at,
        motor_torque_nm=motor,
        joint_torque_nm=axes.joint_torque(motor),
        motor_current_a=np.full((N, 6), np.nan),
        sync_index=np.arange(start, start + N),
        time_s=SYNC_S * np.arange(start, start + N),
    )
    if complete:
        return full_period
    arrays = {
        name: np.delete(getattr(full_period, name), 50, axis=0)
        for name in full_period.__slots__
        if isinstance(getattr(full_period, name), np.ndarray)
    }
    return replace(full_period, **arrays)


@pytest.fixture(autouse=True)
def _in_repository(monkeypatch):
    monkeypatch.chdir(Path(__file__).parents[4])


@pytest.fixture
def path(tmp_path, cell) -> Path:
    """A visit, two whole periods and one that lacks a SYNC."""
    arm = replace(ARM_HEADER, excitations={fingerprint(SERIES): SERIES.plain()})
    periods = [period(1, start=100), period(2, start=600), period(2, start=1100, complete=False)]
    return recording_of(tmp_path / "run.h5", header_of(cell), [visit(1, -1), *periods], arm)


def test_visits_and_periods_come_back_in_the_order_of_measuring(path):
    (arm,) = read(path).arms
    assert [each.number for each in arm.visits] == [1]
    assert [(each.number, each.period, each.complete) for each in arm.periods] == [
        (2, 1, True),
        (3, 2, True),
        (4, 2, False),
    ]
    sent = period(1)
    for name in ("target_rad", "q_rad", "torque_word", "motor_torque_nm", "joint_torque_nm", "sync_index"):
        assert np.allclose(getattr(arm.periods[0], name), getattr(sent, name)), name
    assert arm.excitations == {fingerprint(SERIES): SERIES.plain()}
    assert arm.driven("none") == {(fingerprint(SERIES), 1.0, 1), (fingerprint(SERIES), 1.0, 2)}


def test_rows_of_periods_say_which_motion_they_repeat(path):
    table = read(path).table()
    assert (~table.moving).sum() == 1
    rows = table.take(table.moving)
    assert len(rows) == 2 * N
    assert set(table.run) == {"run"}
    assert set(rows.extra["x_excitation"]) == {float(fingerprint(SERIES))}
    assert set(rows.extra["x_period"]) == {1.0, 2.0}
    assert rows.extra["x_phase_s"][:N] == pytest.approx(np.arange(N) * SYNC_S)
    assert np.isnan(table.extra["x_phase_s"][~table.moving]).all()
    torque_filter_s = load_profile("generic-cia402").torque.filter_s
    q, qd, qdd, _ = SERIES.at(np.arange(N) * SYNC_S - torque_filter_s)
    assert rows.q_rad[:N] == pytest.approx(q, abs=1e-5)
    assert rows.qd_rad_s[:N] == pytest.approx(qd, abs=1e-4)
    assert rows.qdd_rad_s2[:N] == pytest.approx(qdd, abs=1e-2)


def test_the_table_goes_through_a_csv_file(path, tmp_path, cell):
    table = read(path).table()
    write_csv(table, tmp_path / "run.csv")
    again = read_csv(tmp_path / "run.csv", AxisConversion.from_arm(cell.cell.arm[0]))
    assert np.array_equal(again.moving, table.moving)
    for name in ("x_excitation", "x_period", "x_phase_s"):
        assert np.array_equal(again.extra[name], table.extra[name], equal_nan=True)
    assert again.tau_nm == pytest.approx(table.tau_nm)


def test_a_slower_motion_is_another_one():
    number = fingerprint(SERIES)
    assert motion_number(number, 1.0) == number
    assert len({motion_number(number, speed) for speed in (1.0, 0.5, 0.25)}) == 3
    assert motion_number(number, 0.25) == motion_number(number, 0.25)


def test_a_corrected_gear_ratio_is_used(path, cell):
    other = parse_cell(cell.text.replace("{ value = 120,", "{ value = 240,", 1), "cell.toml")
    bound, corrections = bind(read(path), other, other.arm[0])
    before, after = read(path).arms[0].periods[0], bound.arms[0].periods[0]
    assert after.joint_torque_nm[:, 0] == pytest.approx(2.0 * before.joint_torque_nm[:, 0])
    assert after.q_rad[:, 0] == pytest.approx(0.5 * before.q_rad[:, 0])
    assert after.target_rad[:, 0] == pytest.approx(0.5 * before.target_rad[:, 0])
    assert after.joint_torque_nm[:, 1:] == pytest.approx(before.joint_torque_nm[:, 1:])
    assert [each.joint for each in corrections] == [1]


def test_a_file_is_gone_on_with(path, cell):
    earlier: Recording = read(path)
    writer = RecordingWriter(path, header_of(cell), earlier)
    writer.begin(ARM_HEADER)
    stored = writer.add("main", period(2, start=0))
    writer.close()
    assert stored.number == 5
    assert stored.time_s[0] > earlier.arms[0].periods[-1].time_s[-1]
    (arm,) = read(path).arms
    assert [each.number for each in arm.periods] == [2, 3, 4, 5]
    assert arm.excitations


def _without_a_sync(group):
    keep = np.delete(np.arange(N), 77)
    for name in list(group):
        values, unit = group[name][()][keep], group[name].attrs["unit"]
        del group[name]
        group.create_dataset(name, data=values).attrs["unit"] = unit


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_without_a_sync, "SYNC 176 is followed by 178, but the period is marked complete"),
        (lambda group: group.attrs.__setitem__("period_s", 1.997), "a period is a whole number of SYNCs"),
        (lambda group: group.attrs.__setitem__("excitation", 7), "is 7; the file does not contain that excitation"),
        (
            lambda group: group.attrs.__setitem__("kind", "waltz"),
            "load, kind, joint or period has an invalid value",
        ),
        (lambda group: group.attrs.__setitem__("speed", 2.0), "speed must be above 0 and at most 1"),
        (lambda group: group.attrs.__setitem__("speed", "fast"), "is not a finite number"),
        (lambda group: group.__delitem__("target_rad"), "target_rad: is missing"),
    ],
)
def test_a_broken_period_is_refused_with_its_place(path, change, says):
    with h5py.File(path, "r+") as file:
        change(file["arms/main/periods/0002"])
    with pytest.raises(InputError, match=says) as refused:
        read(path)
    assert "/arms/main/periods/0002" in str(refused.value)


def test_too_few_samples_for_what_was_driven_are_refused(path):
    fast = SERIES.plain() | {"cosine_rad": np.zeros((6, 80)).tolist()}
    with h5py.File(path, "r+") as file:
        file["arms/main/excitations"].attrs[str(fingerprint(SERIES))] = json.dumps(fast)
    with pytest.raises(InputError, match="500 SYNCs in a period of 80 harmonics are too few, 640 are needed"):
        read(path)
