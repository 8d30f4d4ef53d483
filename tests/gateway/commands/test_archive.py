"""A stored measurement: everything in it, the same numbers again, and no trust in the file."""

import hashlib
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gateway.data.archive import is_safe
from gateway.jobs.replay import replay
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import robot_from_urdf
from gateway.result.compare import differences
from tests.support.rigs.command_line import run

SMALL = Path(__file__).parents[3] / "examples" / "small"
BAND_NM = np.array([4.0, 4.0, 2.0, 0.6, 0.5, 0.3])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a cell and a table of rest poses, torque in closed form with noise."""
    folder = tmp_path_factory.mktemp("cell")
    for name in ("cell.toml", "robot.urdf"):
        shutil.copy(SMALL / name, folder / name)
    robot = robot_from_urdf((SMALL / "robot.urdf").read_text(encoding="utf-8"), "small")
    rng = np.random.default_rng(4)
    poses = rng.uniform(-1.2, 1.2, (8, 6))
    bodies = np.concatenate([robot.mass_kg[:, None], robot.mass_kg[:, None] * robot.com_m], axis=1)
    names = [pattern.format(joint) for pattern in ("q{}_rad", "dir{}", "tau{}_nm") for joint in range(1, 7)]
    lines = [",".join(["load", "pose", *names])]
    for load, carried in (("none", 0.0), ("tool", 4.0 * np.array([1.0, 0.02, -0.01, 0.12]))):
        parts = bodies.copy()
        parts[5] += carried
        torque = gravity_regressor(robot, poses) @ parts.ravel()
        for number, (q, tau) in enumerate(zip(poses, torque, strict=True), start=1):
            for side in (-1, 1):
                measured = tau + side * BAND_NM + rng.normal(0, 0.05, 6)
                values = (*q.tolist(), *[side] * 6, *measured.tolist())
                lines.append(",".join([load, str(number), *map(repr, values)]))
    (folder / "data").mkdir()
    (folder / "data" / "rows.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def stored(place):
    path = place / "stored.zip"
    rows = place / "data" / "rows.csv"
    words = ["--cell", place / "cell.toml", "--expect", "tool=4,2", "--operator", "A. Person", "--archive", path]
    done = run("estimate", rows, *words)
    assert done.exit_code == 0, done.output
    return path


def members(path):
    with zipfile.ZipFile(path) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def rewritten(path, out, change):
    """The archive with changed members; the manifest follows where `change` changes it."""
    held = members(path)
    change(held)
    with zipfile.ZipFile(out, "w") as written:
        for name, content in held.items():
            written.writestr(name, content)
    return out


def consistent(held, name, content):
    """Replace a member, and its checksum in the manifest."""
    manifest = json.loads(held["manifest.json"])
    held[name], manifest["files"][name] = content, hashlib.sha256(content).hexdigest()
    held["manifest.json"] = json.dumps(manifest).encode()


def test_the_archive_holds_all_files_with_their_checksums(stored, place):
    held = members(stored)
    manifest = json.loads(held.pop("manifest.json"))
    assert manifest["files"] == {name: hashlib.sha256(content).hexdigest() for name, content in held.items()}
    inputs = {"files/cell.toml", "files/robot.urdf", "files/data/rows.csv"}
    assert set(held) == inputs | {"result.json", "certificate.xml"}
    assert held["files/cell.toml"] == (place / "cell.toml").read_bytes()
    assert manifest["command"] == "estimate"
    assert manifest["versions"].keys() >= {"servo-gateway", "python", "numpy"}


def test_replay_gives_the_same_numbers_elsewhere(stored, tmp_path, monkeypatch):
    shutil.copy(stored, tmp_path / "moved.zip")
    monkeypatch.chdir(tmp_path)
    done = run("replay", "moved.zip")
    assert (done.exit_code, "every value is the same" in done.output) == (0, True), done.output
    assert not replay(Path("moved.zip"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["moved.zip"]


@pytest.mark.slow
def test_a_diagnosis_with_its_options_is_replayed(place, tmp_path):
    rows, path = place / "data" / "rows.csv", tmp_path / "d.zip"
    words = ["--robot", place / "robot.urdf", "--without", "base_tilt,axis_coupling", "--warm", "--archive", path]
    done = run("diagnose", rows, *words)
    assert done.exit_code == 0, done.output
    options = json.loads(members(path)["manifest.json"])["options"]
    assert options["without"] == ["axis_coupling", "base_tilt"]
    assert options["model"]["is_warm"] is True
    assert run("replay", path).exit_code == 0


def test_a_number_that_is_not_that_of_the_data_is_listed(stored, tmp_path):
    def change(held):
        result = json.loads(held["result.json"])
        result["loads"][0]["mass_kg"] += 1e-6
        consistent(held, "result.json", json.dumps(result).encode())

    done = run("replay", rewritten(stored, tmp_path / "b.zip", change), "--json", tmp_path / "out.json")
    assert (done.exit_code, "loads[0].mass_kg" in done.output) == (7, True), done.output
    (each,) = json.loads((tmp_path / "out.json").read_text())["differences"]
    assert each["where"] == "loads[0].mass_kg"
    assert each["stored"] - each["again"] == pytest.approx(1e-6)


@pytest.mark.parametrize("name", ["files/data/rows.csv", "result.json", "certificate.xml", "files/robot.urdf"])
def test_a_missing_or_edited_file_is_named(stored, tmp_path, name):
    missing = run("replay", rewritten(stored, tmp_path / "a.zip", lambda held: held.pop(name)))
    assert (missing.exit_code, f"{name} is missing" in missing.output) == (3, True), missing.output
    edited = run("replay", rewritten(stored, tmp_path / "b.zip", lambda held: held.update({name: held[name] + b" "})))
    said = f"{name} was edited; 4 of 5 files are intact" in edited.output
    assert (edited.exit_code, said) == (3, True), edited.output


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", "a\\..\\x", "C:x", "files//x", "./x"])
def test_a_name_that_leaves_the_folder_is_refused(stored, tmp_path, name):
    assert not is_safe(name)
    done = run("replay", rewritten(stored, tmp_path / "a.zip", lambda held: held.update({name: b"x"})))
    assert (done.exit_code, "nothing is extracted" in done.output) == (3, True), done.output
    listed = rewritten(stored, tmp_path / "b.zip", lambda held: consistent(held, name, b"x"))
    assert run("replay", listed).exit_code == 3


def with_options(**changes):
    def change(held):
        manifest = json.loads(held["manifest.json"])
        manifest["options"] |= changes.pop("options", {})
        held["manifest.json"] = json.dumps(manifest | changes).encode()

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (with_options(options={"json_out": "/tmp/x"}), "json_out"),
        (with_options(options={"archive": "/tmp/x"}), "archive"),
        (with_options(options={"data": ["/etc/passwd"]}), "/etc/passwd"),
        (with_options(options={"method": "none"}), "method"),
        (with_options(options={"method": ["--json"]}), "method"),
        (with_options(options={"method": {"a": 1}}), "method"),
        (with_options(options={"model": {"cell": ["files/cell.toml"]}}), "cell"),
        (with_options(options={"model": {"cell_file": "files/cell.toml"}}), "cell_file"),
        (with_options(options={"data": {"a": 1}}), "data"),
        (with_options(command="record"), "record"),
        (with_options(command=["estimate"]), "estimate"),
        (with_options(files=[]), "manifest.json"),
        (with_options(options={"data": 5}), "data"),
        (with_options(options={"say": "x"}), "say"),
        (with_options(schema=2), "manifest.json"),
        (lambda held: held.update({"manifest.json": b"{"}), "manifest.json"),
        (lambda held: held.pop("manifest.json"), "manifest.json"),
        (lambda held: held.update({"files/new": b"x"}), "files/new is not listed"),
    ],
)
def test_a_manifest_that_asks_for_anything_else_is_refused(stored, tmp_path, change, says):
    done = run("replay", rewritten(stored, tmp_path / "a.zip", change))
    assert done.exit_code == 3, done.output
    assert says in done.output
    assert "defect" not in done.output


def test_a_cell_that_names_a_file_outside_is_refused(stored, tmp_path):
    def change(held):
        text = held["files/cell.toml"].replace(b'robot = "robot.urdf"', b'robot = "../../../etc/hostname"')
        consistent(held, "files/cell.toml", text)

    done = run("replay", rewritten(stored, tmp_path / "a.zip", change))
    assert (done.exit_code, "which is not in it" in done.output) == (3, True), done.output


@pytest.mark.parametrize("cut", [0, 10, 1000, -30])
def test_a_damaged_file_gives_one_line(stored, tmp_path, cut):
    path = tmp_path / "a.zip"
    path.write_bytes(stored.read_bytes()[:cut])
    done = run("replay", path)
    assert (done.exit_code, "a.zip" in done.output) == (3, True), done.output


def test_damaged_contents_are_named(stored, tmp_path):
    content = bytearray(stored.read_bytes())
    with zipfile.ZipFile(stored) as opened:
        start = opened.getinfo("files/data/rows.csv").header_offset
    content[start + 200] ^= 0xFF
    path = tmp_path / "a.zip"
    path.write_bytes(bytes(content))
    done = run("replay", path)
    assert (done.exit_code, "files/data/rows.csv" in done.output) == (3, True), done.output


def test_differences_are_of_values_beyond_the_tolerance():
    base = {"a": [1.0, {"b": "x"}], "n": None, "sha256": "1", "data": {"created": "1", "k": 2}}
    assert not differences(base, base | {"sha256": "2", "a": [1.0 + 1e-10, {"b": "x"}]})
    (one,) = differences(base, base | {"a": [1.0, {"b": "y"}]})
    assert (one.where, one.stored, one.again) == ("a[1].b", "x", "y")
    assert [each.where for each in differences(base, {"a": [1.0], "n": 0, "data": {"k": True}})] == ["a", "n", "data.k"]
    assert not differences({"x": 1e9}, {"x": 1e9 + 0.5})
    assert differences({"x": 1e-3}, {"x": 1e-3 + 1e-8})
    old = {"severity": "warn", "where": "calibration", "what": "200 days old"}
    assert not differences({"findings": []}, {"findings": [old]})
