"""profiles new: from an EDS to a profile that a cell can name, by options, a file, questions, and a drive itself."""

from __future__ import annotations

import json
import shutil
import threading
import tomllib

import jsonschema
import pytest
from click.testing import CliRunner

from drives.bus import BusSpec, open_bus
from drives.profile_file import PROFILE_FOLDER, list_profiles, load_profile, profile_schema
from gateway.cli import main
from gateway.commands import profiles as module
from sim.serve import running
from tests.data.product_copy import ROOT

CELL = ROOT / "examples" / "small" / "cell.toml"
ANSWERS = {
    "torque_kind": "permille_rated_torque",
    "torque_nature": "measured",
    "rated_unit": "0.001",
    "torque_source": "manual p. 84",
}


@pytest.fixture
def sheet(tmp_path):
    return shutil.copy(PROFILE_FOLDER / "generic-cia402.eds", tmp_path / "drive.eds")


def new(*arguments, **options):
    return CliRunner().invoke(main, ["profiles", "new", *map(str, arguments)], **options)


def typed(answers):
    return [word for key, value in answers.items() for word in ("--answer", f"{key}={value}")]


def test_a_draft_by_options(sheet, tmp_path):
    done = new("--eds", sheet, "-o", tmp_path / "mine.toml", *typed(ANSWERS))
    assert done.exit_code == 0, done.output
    profile = load_profile(tmp_path / "mine.toml")
    assert (profile.name, profile.obstacles) == ("mine", ())
    assert 'profile = "mine"' in done.output


def test_a_draft_by_a_file_and_an_option_before_it(sheet, tmp_path):
    (tmp_path / "answers.toml").write_text(
        'torque_kind = "permille_rated_torque"\ntorque_nature = "measured"\nrated_unit = 0.001\n'
        'torque_source = "manual p. 84"\n'
    )
    typed_options = ["--answers", tmp_path / "answers.toml", *typed({"rated_unit": "1e-6"})]
    done = new("--eds", sheet, *typed_options, "-o", tmp_path / "a.toml")
    assert done.exit_code == 0, done.output
    assert load_profile(tmp_path / "a.toml").torque.rated.unit == 1e-6


def test_what_stays_open_is_said_in_words_and_as_json(sheet, tmp_path):
    done = new("--eds", sheet, "-o", tmp_path / "mine.toml", "--json", "-")
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert {each["key"] for each in answer["open"]} >= {"torque_kind", "rated_unit", "lost_heartbeat"}
    assert all(each["ways"] for each in answer["open"])
    assert "assumed" in answer["obstacles"][0]
    assert "open: torque_kind" in done.stderr
    assert load_profile(tmp_path / "mine.toml").torque.assumed


def test_at_a_terminal_it_asks_and_asks_again_what_is_no_answer(sheet, tmp_path, monkeypatch):
    lines = ["newton", "permille_rated_torque", "measured", "0.001", "manual p. 1", "", "quick stop"]
    monkeypatch.setattr(module, "_at_terminal", lambda: True)
    done = new("--eds", sheet, "-o", tmp_path / "mine.toml", input="\n".join(lines) + "\n")
    assert done.exit_code == 0, done.output
    assert "torque_kind" in done.stderr
    profile = load_profile(tmp_path / "mine.toml")
    assert (profile.obstacles, profile.velocity, profile.heartbeat.abort_connection) == ((), None, 3)


def test_a_profile_that_is_there_is_not_replaced(sheet, tmp_path):
    output = tmp_path / "mine.toml"
    output.write_text("precious")
    done = new("--eds", sheet, "-o", output)
    assert (done.exit_code, output.read_text()) == (3, "precious")
    assert "not replaced" in done.output


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--eds", "none.eds", "-o", "a.toml"], 3, "none.eds"),
        (["--eds", "drive.eds", "-o", "a.txt"], 2, ".toml"),
        (["--eds", "drive.eds", "-o", "maxon-epos4.toml"], 3, "choose another"),
        (["--eds", "drive.eds", "-o", "a.toml", "--bus", "virtual:a"], 2, "--from-drive"),
        (["--eds", "drive.eds", "-o", "a.toml", "--from-drive", "1"], 4, "can0"),
        (["--eds", "drive.eds", "-o", "a.toml", "--answer", "torque_kind"], 2, "KEY=VALUE"),
        (["--eds", "drive.eds", "-o", "a.toml", "--answer", "torque=x"], 3, "unknown key torque; write torque_"),
        (["--eds", "drive.eds", "-o", "a.toml", "--name", "../x"], 3, "name"),
    ],
)
def test_mistakes_are_named_and_nothing_is_written(sheet, tmp_path, monkeypatch, arguments, code, says):
    monkeypatch.chdir(tmp_path)
    done = new(*arguments)
    assert done.exit_code == code, done.output
    assert says in done.output
    assert "Traceback" not in done.output
    assert [path.name for path in tmp_path.iterdir()] == ["drive.eds"]


def test_a_drive_is_asked_and_nothing_is_written_to_it(sheet, tmp_path):
    pytest.importorskip("pybullet", reason="the simulated drives need the extra [sim]")
    with running(CELL, "virtual:profiles-new", pacing="lockstep") as handle:
        with open_bus(BusSpec.parse(handle.bus)) as ear:
            done = new(
                "--eds", sheet, "--from-drive", 2, "--bus", handle.bus, "-o", tmp_path / "mine.toml", *typed(ANSWERS)
            )  # fmt: skip
            requests = []
            while (frame := ear.receive(0.0)) is not None:
                if frame.arbitration_id < 0x180 or frame.arbitration_id > 0x600:
                    requests.append((frame.arbitration_id, frame.data[0] & 0xE0))
        drive = handle.simulation.arms[0].drives[1]
        rated = drive.store.number((0x6076, 0))
    assert done.exit_code == 0, done.output
    profile = load_profile(tmp_path / "mine.toml")
    assert profile.identity.vendor_id == 0x53A
    assert f"read from node 2: {rated}" in profile.text
    # uploads alone: initiate 0x40, segments 0x60
    sent = {command for can_id, command in requests if can_id == 0x602}
    assert sent <= {0x40, 0x60}
    assert sent
    assert {can_id for can_id, _ in requests if 0x600 <= can_id < 0x680} == {0x602}
    assert not {can_id for can_id, _ in requests if can_id < 0x180}


def test_the_sheet_of_another_drive_is_refused(sheet, tmp_path):
    pytest.importorskip("pybullet", reason="the simulated drives need the extra [sim]")
    path = tmp_path / "drive.eds"
    path.write_text(path.read_text().replace("VendorNumber=0", "VendorNumber=0x99"))
    with running(CELL, "virtual:profiles-other", pacing="lockstep") as handle:
        done = new("--eds", sheet, "--from-drive", 2, "--bus", handle.bus, "-o", tmp_path / "mine.toml")
        gone = new("--eds", sheet, "--from-drive", 99, "--bus", handle.bus, "-o", tmp_path / "mine.toml")
    assert (done.exit_code, gone.exit_code) == (4, 4)
    assert "0x53a instead of 0x99" in done.output
    assert "node 99" in gone.output
    assert not (tmp_path / "mine.toml").exists()


def test_beside_a_running_master_nothing_is_sent(sheet, tmp_path):
    """SYNC of another master is received: no frame goes out."""
    with open_bus(BusSpec.parse("virtual:profiles-busy")) as other:
        beating = threading.Event()

        def beat():
            while not beating.wait(0.02):
                other.send(0x080, b"")

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            done = new(
                "--eds", sheet, "--from-drive", 2, "--bus", "virtual:profiles-busy", "-o", tmp_path / "mine.toml"
            )  # fmt: skip
        finally:
            beating.set()
            thread.join()
        received = other.receive(0.0)
    assert done.exit_code == 4, done.output
    assert "another master" in done.output
    assert received is None


# -- the schema --------------------------------------------------------------------------------------------------------


def test_the_schema_is_one_that_editors_read():
    schema = profile_schema()
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    jsonschema.Draft202012Validator.check_schema(schema)


@pytest.mark.parametrize("name", list_profiles())
def test_every_profile_fits_the_schema(name):
    jsonschema.validate(tomllib.loads(load_profile(name).text), profile_schema())


def test_a_mistake_does_not_fit_the_schema():
    table = tomllib.loads(load_profile("generic-cia402").text)
    table["torque"]["kind"] = "newton"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(table, profile_schema())
