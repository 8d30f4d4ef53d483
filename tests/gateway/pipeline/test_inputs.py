"""Data carries its arm: measurements of another arm are refused, constants corrected since are used and named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drives.profile_file import PROFILE_FOLDER, parse_profile
from gateway.cell.config import load_cell
from gateway.data.recording.writer import RecordingWriter
from gateway.errors import ConfigError, InputError
from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.pipeline.finalize import finalize
from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
from gateway.result.result import Result
from tests.cells import CELLS
from tests.data.recordings import several
from tests.data.visits import ARM_HEADER, both_sides, header_of, recording_of, visit

EXAMPLES = Path(__file__).parents[3] / "examples"
TABLE = "pose," + ",".join(f"q{i}_rad" for i in range(1, 7)) + ",i2_a\n1,0,0,0,0,0,0,2\n"

Edit = Callable[[str], str]


@pytest.fixture
def cell_at(tmp_path: Path) -> Callable[..., Path]:
    """Write the small cell, edited, into a folder of its own, measuring current where asked."""

    def make(name: str, edit: Edit = lambda text: text, robot: str = "small") -> Path:
        folder = tmp_path / name
        folder.mkdir()
        shutil.copy(EXAMPLES / robot / "robot.urdf", folder / "robot.urdf")
        (folder / "cell.toml").write_text(edit((EXAMPLES / "small" / "cell.toml").read_text()))
        return folder / "cell.toml"

    return make


@pytest.fixture
def record(tmp_path: Path) -> Callable[..., Path]:
    """Write a recording of two poses, made with a cell."""

    def make(cell: Path, name: str = "run.h5", serials: tuple[int | None, ...] = (), load: str = "none") -> Path:
        identities = [{"node_id": n, "serial_number": serial} for n, serial in enumerate(serials, start=1)]
        arm = replace(ARM_HEADER, identities=identities)
        return recording_of(tmp_path / name, header_of(load_cell(cell)), both_sides(1, 2, load=load), arm)

    return make


def test_recording_under_its_own_cell(cell_at, record):
    cell = cell_at("own")
    path = record(cell)
    alone, named = collect_inputs(ModelRequest(), [path]), collect_inputs(ModelRequest(cell=cell), [path])
    assert not named.corrections
    assert read_rows([path], named).tau_nm == pytest.approx(read_rows([path], alone).tau_nm)


def test_recording_of_another_robot_is_refused(cell_at, record):
    path, other = record(cell_at("own")), cell_at("other", robot="large")
    with pytest.raises(
        InputError, match=r"run.h5: was recorded .* and in robot .*, the positions of axis \d differ by \d+ mm"
    ):
        collect_inputs(ModelRequest(cell=other), [path])
    with pytest.raises(InputError, match="differ by .* mm"):
        collect_inputs(ModelRequest(robot=EXAMPLES / "large" / "robot.urdf"), [path])


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda text: text.replace('name = "main"', 'name = "left"'), "contains no arm 'left' but 'main'"),
        (
            lambda text: text.replace("node_id = 2\n", "node_id = 12\n"),
            "J2 was recorded with node_id 2, the cell says 12",
        ),
        (
            lambda text: text.replace("position_sign = 1", "position_sign = -1", 1),
            "J1 was recorded with position_sign 1",
        ),
        (
            lambda text: text.replace("gear_ratio = { value = 120", "gear_ratio = { value = -120", 1),
            "a gear_ratio of sign",
        ),
    ],
)
def test_drives_wired_otherwise_are_refused(cell_at, record, edit, says):
    path = record(cell_at("own"))
    other = cell_at("other", edit)
    assert other.read_text() != (EXAMPLES / "small" / "cell.toml").read_text()
    with pytest.raises(InputError, match=says):
        collect_inputs(ModelRequest(cell=other), [path])


def test_corrected_constants_are_used_and_named(cell_at, record):
    path = record(cell_at("own"))
    corrected = cell_at(
        "corrected",
        lambda text: text.replace("gear_ratio = { value = 120", "gear_ratio = { value = 121", 1).replace(
            "zero_offset_rad = 0.0", "zero_offset_rad = 0.1", 1
        ),
    )
    before = read_rows([path], collect_inputs(ModelRequest(), [path]))
    about = collect_inputs(ModelRequest(cell=corrected), [path])
    after = read_rows([path], about)
    assert after.tau_nm[:, 0] == pytest.approx(before.tau_nm[:, 0] * 121 / 120)
    assert after.tau_nm[:, 1:] == pytest.approx(before.tau_nm[:, 1:])
    assert after.q_rad[:, 0] == pytest.approx(before.q_rad[:, 0] * 120 / 121 + 0.1)
    assert [str(each) for each in about.corrections] == [
        "J1 gear_ratio 121, recorded with 120",
        "J1 zero_offset_rad 0.1, recorded with 0",
    ]
    said = [(finding.where, finding.what) for finding in finalize(Result("small"), about, after, [path]).findings]
    assert said == [
        ("J1", "gear_ratio 121, recorded with 120: recomputed with the constants of the cell file"),
        ("J1", "zero_offset_rad 0.1, recorded with 0: recomputed with the constants of the cell file"),
    ]


@pytest.mark.parametrize(("status", "reported"), [("success", False), ("abort", True), ("fail", True), (None, True)])
def test_a_result_of_an_unfinished_recording_says_so(tmp_path, status, reported):
    path = several(tmp_path / "run.h5", "seven", status=status)
    about = collect_inputs(ModelRequest(), [path])
    findings = finalize(Result("seven"), about, read_rows([path], about), [path]).findings
    unfinished = [finding for finding in findings if finding.where == "recording"]
    assert [finding.severity for finding in unfinished] == ["warn"] * reported
    for finding in unfinished:
        assert f"status {status or 'abort'}: " in finding.what
        assert status is None or "done" in finding.what


def test_corrected_torque_constant_scales_what_was_measured_as_current(cell_at, record, monkeypatch):
    path = record(cell_at("own"))
    corrected = cell_at("corrected", lambda text: text.replace("{ value = 0.31,", "{ value = 0.62,", 1))
    as_torque = read_rows([path], collect_inputs(ModelRequest(cell=corrected), [path])).tau_nm
    text = (PROFILE_FOLDER / "generic-cia402.toml").read_text()
    own = read_rows([path], collect_inputs(ModelRequest(), [path])).tau_nm
    assert as_torque == pytest.approx(own)  # a drive that reports torque has its own torque constant
    profile = parse_profile(text, "generic")
    current = profile.model_copy(
        update={
            "torque": profile.torque.model_copy(
                update={"kind": "permille_rated_current", "current_reference": "rms", "torque_constant_per": "rms"}
            )
        }
    )
    monkeypatch.setattr("gateway.data.recording.recorded.parse_profile", lambda *_: current)
    monkeypatch.setattr("gateway.data.recording.reader.SAME_TORQUE", 1e9)
    recorded = read_rows([path], collect_inputs(ModelRequest(), [path])).tau_nm
    scaled = read_rows([path], collect_inputs(ModelRequest(cell=corrected), [path])).tau_nm
    assert scaled[:, 0] == pytest.approx(2.0 * recorded[:, 0])
    assert scaled[:, 1:] == pytest.approx(recorded[:, 1:])


def test_two_recordings_with_other_constants_need_a_cell(cell_at, record):
    first = record(cell_at("own"), "first.h5")
    second = record(
        cell_at("other", lambda text: text.replace("value = 120", "value = 121", 1)), "second.h5", load="load"
    )
    with pytest.raises(InputError, match=r"second.h5: J1 gear_ratio 120, recorded with 121: first.h5 .* by --cell"):
        collect_inputs(ModelRequest(), [first, second])
    about = collect_inputs(ModelRequest(cell=cell_at("third")), [first, second])
    assert len(about.corrections) == 1
    assert len(read_rows([first, second], about)) == 8


def test_recordings_of_other_drives_are_refused(cell_at, record):
    cell = cell_at("own")
    first = record(cell, "first.h5", (11, 12, 13, 14, 15, 16))
    second = record(cell, "second.h5", (11, 12, 99, 14, 15, 16), load="load")
    without_torque = record(cell, "no-torque.h5", (None, 0, None, None, None, None), load="other")
    collect_inputs(ModelRequest(), [first, without_torque])
    with pytest.raises(InputError, match=r"second.h5: J3 .* serial number 99, in first.h5 it was 13"):
        collect_inputs(ModelRequest(), [first, second])


def test_table_of_a_cell_with_two_arms_needs_the_arm(tmp_path):
    (tmp_path / "t.csv").write_text(TABLE)
    shutil.copytree(EXAMPLES / "pair", tmp_path / "pair")
    pair = tmp_path / "pair" / "cell.toml"
    second = pair.read_text().split("\n[[arm]]\n", 2)[2]
    pair.write_text(
        pair.read_text().replace(second, second.replace("gear_ratio = { value = ", "gear_ratio = { value = 1"))
    )
    with pytest.raises(ConfigError, match="no arm was named; it has left, right: name one by --arm"):
        collect_inputs(ModelRequest(cell=pair), [tmp_path / "t.csv"])
    arms = {arm.name: arm for arm in load_cell(pair).cell.arm}
    assert len({arm.axis[1].gear_ratio.value for arm in arms.values()}) == 2
    for name, arm in arms.items():
        about = collect_inputs(ModelRequest(cell=pair, arm=name), [tmp_path / "t.csv"])
        axis = arm.axis[1]
        expected = 2.0 * axis.torque_constant_nm_per_a.value * axis.gear_ratio.value * axis.torque_sign
        assert read_rows([tmp_path / "t.csv"], about).tau_nm[0, 1] == pytest.approx(expected)


def test_each_arm_of_a_recording_has_its_own_rows(tmp_path):
    loaded = load_cell(EXAMPLES / "pair" / "cell.toml")
    header = header_of(loaded)
    header = replace(
        header, profiles={axis.profile: header.profiles["generic-cia402"] for axis in loaded.cell.arm[0].axis}
    )
    writer = RecordingWriter(tmp_path / "both.h5", header, None)
    for number, arm in enumerate(loaded.cell.arm):
        writer.begin(replace(ARM_HEADER, name=arm.name))
        writer.add(arm.name, visit(1, -1, seed=number, start_s=number))
        writer.finish(arm.name, "success", "", {})
    writer.close()
    with pytest.raises(ConfigError, match="no arm was named"):
        collect_inputs(ModelRequest(), [tmp_path / "both.h5"])
    rows = {}
    for arm in loaded.cell.arm:
        about = collect_inputs(ModelRequest(arm=arm.name), [tmp_path / "both.h5"])
        rows[arm.name] = read_rows([tmp_path / "both.h5"], about)
        assert len(rows[arm.name]) == 1
    first, second = rows.values()
    assert np.abs(first.tau_nm - second.tau_nm).max() > 1.0


def test_bare_identification_of_another_robot_is_refused(tmp_path, cell_at, record):
    cell = cell_at("own")
    path = record(cell)
    about = collect_inputs(ModelRequest(cell=EXAMPLES / "large" / "cell.toml"), [])
    table = read_rows([path], collect_inputs(ModelRequest(), [path]))
    bare = run(table, about.model, Knowledge(link_std=0.1), "joint").bare
    assert bare is not None
    from gateway.result.result import to_json

    (tmp_path / "bare.json").write_text(to_json(Result("large", bare=bare)))
    collect_inputs(ModelRequest(cell=EXAMPLES / "large" / "cell.toml", bare=tmp_path / "bare.json"), [])
    with pytest.raises(InputError, match="--bare: it identified robot"):
        collect_inputs(ModelRequest(cell=cell, bare=tmp_path / "bare.json"), [path])


def test_a_table_of_another_number_of_axes_than_the_robot_is_refused_by_both(tmp_path: Path) -> None:
    four = CELLS[0]
    path = tmp_path / "six.csv"
    path.write_text(TABLE.replace("i2_a", "tau2_nm"))
    about = collect_inputs(ModelRequest(robot=four.folder / "robot.urdf"), [path])
    with pytest.raises(InputError, match=r"six.csv: the data have 6 axes, but robot 'pallet4' has 4"):
        read_rows([path], about)
    with pytest.raises(InputError, match=r"six.csv:1: columns of 6 axes, and the arm of the cell has 4"):
        read_rows([path], collect_inputs(ModelRequest(cell=four.folder / "cell.toml"), [path]))


def test_a_recording_of_another_number_of_axes_than_the_cell_is_refused_by_both(
    cell_at: Callable[..., Path], record: Callable[..., Path]
) -> None:
    run = record(cell_at("six"))
    with pytest.raises(InputError, match=r"recorded with an arm of 6 axes, the cell's 'main' has 4"):
        collect_inputs(ModelRequest(cell=CELLS[0].folder / "cell.toml"), [run])


def test_a_robot_of_another_number_of_axes_than_the_cell_is_refused_by_both(cell_at: Callable[..., Path]) -> None:
    cell = cell_at("six")
    shutil.copy(CELLS[1].folder / "robot.urdf", cell.parent / "robot.urdf")
    with pytest.raises(ConfigError, match=r"robot 'light7' has 7 axes, arm 'main' 6 \[\[arm.axis\]\] tables"):
        collect_inputs(ModelRequest(cell=cell), [])


def test_torque_constants_are_trusted_as_the_cell_says(cell_at, record):
    """The drives of the examples report torque by constants of their own; what a cell states goes before that."""
    plain, stated = cell_at("plain"), cell_at("stated")
    text = stated.read_text()
    stated.write_text(text.replace('source = "datasheet p. 2" }', 'source = "datasheet p. 2", std_percent = 2 }', 1))
    path = record(plain)
    assert collect_inputs(ModelRequest(), [path]).knowledge.gain_std == pytest.approx((0.03,) * 6)
    assert collect_inputs(ModelRequest(cell=stated), [path]).knowledge.gain_std == pytest.approx((0.02, *(0.03,) * 5))
    assert collect_inputs(ModelRequest(gain_std=0.01), [path]).knowledge.gain_std == (0.01,) * 6


def test_coupled_axes_of_a_cell_reach_estimate_and_diagnose(cell_at):
    rows = str(np.where(np.arange(36).reshape(6, 6) == 34, 0.9, np.eye(6)).tolist())
    coupled = cell_at("coupled", lambda text: text.replace("[[arm.axis]]", f"coupling = {rows}\n\n[[arm.axis]]", 1))
    matrix = np.eye(6)
    matrix[5, 4] = 0.9
    about = collect_inputs(ModelRequest(cell=coupled), [])
    assert about.knowledge.coupling == pytest.approx(matrix)
    assert collect_inputs(ModelRequest(cell=cell_at("plain")), []).knowledge.coupling is None


def test_a_table_without_a_cell_states_no_constants():
    robot = EXAMPLES / "large" / "robot.urdf"
    assert collect_inputs(ModelRequest(robot=robot), []).knowledge.gain_std is None


def test_a_recording_of_another_cell_is_refused_and_both_are_named(cell_at, record):
    path = record(cell_at("first"))
    other = cell_at("other", lambda text: text.replace('name = "small"', 'name = "other"', 1))
    with pytest.raises(InputError, match=r"run\.h5: was recorded with cell 'small', this is cell 'other'; name"):
        collect_inputs(ModelRequest(cell=other), [path])
