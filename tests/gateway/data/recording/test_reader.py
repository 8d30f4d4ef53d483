"""Recording: what goes in comes out, survives kills and full disks, and damage is a typed error."""

import json
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from gateway.cell.config import LoadedCell, load_cell
from gateway.cell.conversion import AxisConversion
from gateway.data.recording import seal
from gateway.data.recording.reader import read
from gateway.data.recording.writer import RecordingHeader, RecordingWriter, write_recording
from gateway.errors import InputError
from tests.data.visits import ARM_HEADER, CONSTANTS, POSES, SAMPLES, both_sides, header_of, recording_of, visit


@pytest.fixture(scope="module")
def cell() -> LoadedCell:
    return load_cell(Path(__file__).parents[4] / "examples" / "small" / "cell.toml")


@pytest.fixture(scope="module")
def header(cell) -> RecordingHeader:
    return header_of(cell)


@pytest.fixture(autouse=True)
def _in_repository(monkeypatch):
    monkeypatch.chdir(Path(__file__).parents[4])


@pytest.fixture
def path(tmp_path, header) -> Path:
    return recording_of(tmp_path / "run.h5", header, both_sides(1, 2, 3))


def test_everything_comes_back(path, header):
    recording = read(path)
    assert (recording.exit_status, recording.reason) == ("success", "all poses measured")
    assert recording.cell_text == header.cell
    assert recording.robot_text == header.robot
    assert recording.profiles == header.profiles
    assert recording.created == header.created
    (arm,) = recording.arms
    assert arm.poses == POSES
    assert arm.constants == (CONSTANTS,) * 6
    assert arm.bus_statistics == {"cycles": 7}
    assert arm.ledger == [{"index": 0x6060, "old": 1}]
    assert [stored.number for stored in arm.visits] == [1, 2, 3, 4, 5, 6]
    expected = visit(1, -1)
    stored = arm.visits[0]
    for name in ("statusword", "position_count", "torque_word", "current_word", "velocity_word", "sync_index"):
        assert np.array_equal(getattr(stored, name), getattr(expected, name)), name
    for name in ("q_rad", "motor_torque_nm", "joint_torque_nm", "motor_current_a", "target_rad"):
        assert getattr(stored, name) == pytest.approx(getattr(expected, name)), name
    assert stored.incomplete_epochs == 2
    assert stored.complete


def test_layout_of_the_file(path, header):
    with h5py.File(path) as file:
        assert file.attrs["schema"] == 1
        assert file.attrs["cell"] == header.cell
        assert json.loads(file.attrs["profiles"]) == header.profiles
        assert file.attrs["exit_status"] == "success"
        group = file["/arms/main/visits/0003"]
        assert (group.attrs["load"], group.attrs["pose"], group.attrs["approach"]) == ("none", 2, -1)
        assert bool(group.attrs["complete"])
        for name in ("statusword", "position_count", "torque_permille", "current_permille", "q_rad", "motor_torque_nm"):
            assert group[name].shape == (SAMPLES, 6)
            assert group[name].attrs["unit"]
        for name in ("sync_index", "time_s"):
            assert group[name].shape == (SAMPLES,)
        assert group["statusword"].dtype == np.uint16
        assert "velocity_word" not in group


def test_table_has_two_rows_per_pose(path, cell):
    table = read(path).table()
    axes = AxisConversion.from_arm(cell.cell.arm[0])
    assert len(table) == 6
    assert table.pose.tolist() == [1, 1, 2, 2, 3, 3]
    assert table.direction[:, 0].tolist() == [-1, 1] * 3
    assert table.run.tolist() == ["run"] * 6
    assert table.line.tolist() == [1, 2, 3, 4, 5, 6]
    assert table.count.tolist() == [SAMPLES] * 6
    assert table.extra["x_validation"].tolist() == [0, 0, 0, 0, 1, 1]
    expected = visit(1, 1)
    words = expected.torque_word * 2.0 / 1000
    assert table.motor_torque_nm[1] == pytest.approx(words.mean(axis=0))
    assert table.tau_nm[1] == pytest.approx(words.mean(axis=0) * axes.ratio * axes.torque_sign)
    assert table.tau_std_nm[1] == pytest.approx(words.std(axis=0, ddof=1) * np.abs(axes.ratio))
    assert table.q_rad[1] == pytest.approx(expected.q_rad.mean(axis=0))


def test_a_run_that_was_cut_says_so_and_is_gone_on_with(tmp_path, header):
    path = recording_of(tmp_path / "run.h5", header, [visit(1, -1), visit(1, 1, start_s=1.0)], finish=False)
    earlier = read(path)
    assert earlier.exit_status == "abort"
    assert "not finished" in earlier.reason
    assert earlier.arms[0].missing("none") == ((2, -1), (2, 1), (3, -1), (3, 1))
    assert earlier.arms[0].missing("a") == tuple((pose, side) for pose in (1, 2, 3) for side in (-1, 1))
    writer = RecordingWriter(path, header, earlier)
    writer.begin(ARM_HEADER)
    writer.add("main", visit(2, -1))
    writer.add("main", visit(2, 1, start_s=0.7))
    writer.finish("main", "success", "", {})
    writer.close()
    visits = read(path).arms[0].visits
    assert [(v.number, v.pose, v.approach) for v in visits] == [(1, 1, -1), (2, 1, 1), (3, 2, -1), (4, 2, 1)]
    starts = [v.time_s[0] for v in visits]
    assert (np.diff(starts) > 0).all()
    assert starts[3] - starts[2] == pytest.approx(0.7)
    assert np.array_equal(visits[0].torque_word, visit(1, -1).torque_word)


def test_incomplete_visits_are_kept_but_no_rows(tmp_path, header):
    cut = replace(visit(2, -1), complete=False)
    recording = read(recording_of(tmp_path / "run.h5", header, [visit(1, -1), cut]))
    assert recording.arms[0].done("none") == ((1, -1),)
    assert recording.table().pose.tolist() == [1]
    only = read(recording_of(tmp_path / "cut.h5", header, [cut]))
    with pytest.raises(InputError, match="no complete visit"):
        only.table()


def test_an_existing_file_is_not_overwritten(path, header):
    content = path.read_bytes()
    with pytest.raises(InputError, match="--resume"):
        RecordingWriter(path, header, None)
    with pytest.raises(InputError, match="another cell file"):
        RecordingWriter(path, replace(header, cell=header.cell + "\n"), read(path))
    assert path.read_bytes() == content


def test_a_failed_write_leaves_the_file_before(path, monkeypatch):
    content = path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        write_recording(path, b"x" * 100)
    assert path.read_bytes() == content
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_a_killed_writer_leaves_a_whole_file(tmp_path):
    """A process that records in a loop is killed at once; what it had reported as written is there."""
    script = textwrap.dedent(
        f"""
        from pathlib import Path
        from gateway.cell.config import load_cell
        from gateway.data.recording.writer import RecordingWriter
        from tests.data import visits as t
        header = t.header_of(load_cell(Path("examples/small/cell.toml").resolve()))
        writer = RecordingWriter(Path({str(tmp_path / "run.h5")!r}), header, None)
        writer.begin(t.ARM_HEADER)
        for number in range(10_000):
            print(writer.add("main", t.visit(1 + number % 3, -1, seed=number)).number, flush=True)
        """
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        reported = 0
        for line in process.stdout:
            reported = int(line)
            if reported == 15:
                break
    finally:
        process.kill()
        if process.stdout is not None:
            process.stdout.close()
        process.wait()
    visits = read(tmp_path / "run.h5").arms[0].visits
    assert len(visits) >= reported
    assert [each.number for each in visits] == list(range(1, len(visits) + 1))


def edit(path: Path, change) -> None:
    """Change a file as other software would: the seal is cut off."""
    with h5py.File(path, "r+") as file:
        change(file)


def forge(path: Path, change) -> None:
    """Change a file and seal it again."""
    edit(path, change)
    path.write_bytes(seal.sealed(path.read_bytes()))


def _words(file) -> None:
    file["/arms/main/visits/0002/torque_permille"][3, 2] += 1


def _replace(name: str, value):
    def change(file) -> None:
        del file[name]
        file[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.attrs.__delitem__("schema"), "@schema: is missing"),
        (lambda f: f.attrs.__setitem__("schema", 2), "@schema: is 2"),
        (lambda f: f.attrs.__setitem__("schema", "1"), "@schema: is str"),
        (lambda f: f.attrs.__setitem__("exit_status", "ok"), "@exit_status: is 'ok'"),
        (lambda f: f.attrs.__setitem__("cell", "name ="), "not valid TOML"),
        (lambda f: f.attrs.__setitem__("cell", 5), "@cell: is int64, text expected"),
        (lambda f: f.attrs.__setitem__("profiles", "{}"), "contains no profile 'generic-cia402'"),
        (lambda f: f.attrs.__setitem__("profiles", "{"), "@profiles: is not JSON"),
        (lambda f: f.__delitem__("arms"), "arms: is missing"),
        (lambda f: f.move("/arms/main", "/arms/left"), "visits of arm 'left'"),
        (lambda f: f["/arms/main"].attrs.__setitem__("constants", "[1]"), "@constants: is damaged"),
        (lambda f: f["/arms/main"].attrs.__setitem__("constants", "[]"), None),
        (_words, "0002/motor_torque_nm: disagrees with torque_permille"),
        (_replace("/arms/main/visits/0001/q_rad", np.zeros((SAMPLES, 5))), "q_rad: has the shape (12, 5)"),
        (_replace("/arms/main/visits/0001/q_rad", np.zeros((3, 6))), "q_rad: has 3 samples"),
        (_replace("/arms/main/visits/0001/q_rad", np.full((SAMPLES, 6), np.nan)), "q_rad: contains a value"),
        (_replace("/arms/main/visits/0001/q_rad", [b"x"] * SAMPLES), "q_rad: has the shape"),
        (_replace("/arms/main/visits/0001/statusword", np.zeros((SAMPLES, 6))), "statusword: holds float64"),
        (_replace("/arms/main/visits/0001/sync_index", np.zeros(SAMPLES, dtype=int)), "sync_index: does not increase"),
        (_replace("/arms/main/visits/0001/time_s", h5py.ExternalLink("x.h5", "/")), "is a link out of the file"),
        (lambda f: f["/arms/main/visits/0001"].attrs.__setitem__("approach", 0), "0001: load, purpose or approach"),
        (lambda f: f["/arms/main/visits/0001"].attrs.__delitem__("pose"), "0001/@pose: is missing"),
        (lambda f: f["/arms/main/visits"].move("0001", "first"), "first: is not a number"),
        (lambda f: f["/arms/main/visits"].__setitem__("0009", 3), "0009: is not a group"),
    ],
)
def test_damaged_content_is_named(path, change, message):
    forge(path, change)
    if message is None:
        assert read(path).arms[0].constants == ()
        return
    with pytest.raises(InputError) as refused:
        read(path)
    assert str(path) in str(refused.value)
    assert message in str(refused.value)


def _stored_elsewhere(kind):
    """The torque words of a visit, as HDF5 keeps them in another file: a pipe, which would block its reader."""

    def change(file) -> None:
        group, pipe = file["/arms/main/visits/0001"], Path(file.filename).with_name("pipe")
        shape = group["torque_permille"].shape
        del group["torque_permille"]
        if kind == "external":
            os.mkfifo(pipe)
            group.create_dataset("torque_permille", shape, "i4", external=[(str(pipe), 0, h5py.h5f.UNLIMITED)])
        else:
            layout = h5py.VirtualLayout(shape, "i4")
            layout[:] = h5py.VirtualSource(str(pipe), "numbers", shape)
            group.create_virtual_dataset("torque_permille", layout)

    return change


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_numbers_in_another_file_are_not_read(path, kind):
    forge(path, _stored_elsewhere(kind))
    with pytest.raises(InputError, match="0001/torque_permille: stores its numbers in another file"):
        read(path)


@pytest.mark.parametrize("what", ["visit", "dataset"])
def test_an_object_that_is_linked_many_times_is_read_not_even_once(path, what):
    def change(file) -> None:
        visits = file["/arms/main/visits"]
        if what == "visit":
            for number in range(100, 9100):
                visits[f"{number:04d}"] = visits["0001"]
        else:
            visits["0002/other"] = visits["0001/q_rad"]

    forge(path, change)
    with pytest.raises(InputError, match="is linked more than once"):
        read(path)


def test_a_forged_heap_that_libhdf5_does_not_leave_is_read_by_another_process(path, monkeypatch):
    """Free space of size 0 in a global heap: libhdf5 does not return, and the checksum was made to fit."""
    body = bytearray(path.read_bytes()[: -seal.SEAL_BYTES])
    first_object = body.index(b"GCOL\x01") + 16
    body[first_object : first_object + 16] = bytes(16)
    path.write_bytes(seal.sealed(bytes(body)))
    monkeypatch.setattr(seal, "PROBE_TIMEOUT_S", 1.0)
    with pytest.raises(InputError, match="is damaged: reading it does not end"):
        read(path)


def test_a_recording_as_it_was_written_needs_no_other_process(path, monkeypatch):
    monkeypatch.setattr(seal.sys, "executable", "/bin/false")
    assert read(path).exit_status == "success"


@pytest.mark.parametrize("label", ["a\x1b]0;mine\x07", "a\nb", "a\N{RIGHT-TO-LEFT OVERRIDE}b", ""])
def test_a_label_that_would_control_a_terminal_is_not_read(path, label):
    forge(path, lambda file: file["/arms/main/visits/0001"].attrs.__setitem__("load", label))
    with pytest.raises(InputError, match="0001/@load: is empty or contains control characters"):
        read(path)


def test_a_dataset_that_claims_more_than_the_file_is_not_read(path):
    def change(file) -> None:
        group = file["/arms/main/visits/0001"]
        del group["torque_permille"]
        group.create_dataset("torque_permille", (10**9, 6), dtype="i4", chunks=(1000, 6))

    forge(path, change)
    with pytest.raises(InputError, match="claims 24000000000 bytes"):
        read(path)


@pytest.mark.parametrize("content", [b"", b"not hdf5", b"\x89HDF\r\n\x1a\n", b"\x00" * 5000])
def test_foreign_files(tmp_path, content):
    path = tmp_path / "run.h5"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"not an HDF5 file|truncated"):
        read(path)


def test_no_file_and_a_folder(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "none.h5")
    with pytest.raises(InputError):
        read(tmp_path)


def test_truncated_files(path, tmp_path):
    content = path.read_bytes()
    for share in np.linspace(0.02, 0.98, 25):
        cut = tmp_path / "cut.h5"
        cut.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError):
            read(cut)


def test_flipped_bytes_are_seen_before_libhdf5_sees_the_file(path, tmp_path):
    content = path.read_bytes()
    random = np.random.default_rng(1)
    bad = tmp_path / "bad.h5"
    for count in (1, 1, 1, 3, 30) * 60:
        damaged = bytearray(content)
        for at in random.integers(0, len(content) - 100, count):
            damaged[at] ^= 1 << random.integers(0, 8)
        if damaged == content:
            continue
        bad.write_bytes(damaged)
        with pytest.raises(InputError):
            read(bad)


def test_a_file_edited_by_others_is_still_read(path):
    edit(path, lambda f: f["/arms/main/visits/0001"].attrs.__setitem__("load", "heavy"))
    assert b"sha256" not in path.read_bytes()[-200:]
    assert read(path).arms[0].visits[0].load == "heavy"


def test_a_crash_of_the_library_is_a_typed_error(path, monkeypatch):
    """The process that reads a file without seal dies or never ends."""
    edit(path, lambda f: f.attrs.__setitem__("reason", "edited"))
    monkeypatch.setattr(seal.sys, "executable", "/bin/false")
    with pytest.raises(InputError, match="libhdf5 fails on it"):
        read(path)
    endless = path.parent / "endless"
    endless.write_text("#!/bin/sh\nexec sleep 60\n")
    endless.chmod(0o755)
    monkeypatch.setattr(seal.sys, "executable", str(endless))
    monkeypatch.setattr(seal, "PROBE_TIMEOUT_S", 0.05)
    with pytest.raises(InputError, match="does not end"):
        read(path)
