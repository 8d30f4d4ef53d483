"""The checksum of a result file: what it sees, what it does not, and the message for an edited file."""

import hashlib
import json

import pytest

from gateway.errors import InputError
from gateway.result.result import LoadResult, Result, from_json, read_result, to_dict, to_json
from tests.support.rigs.command_line import run

RESULT = Result("small", (LoadResult("tüte", 6.0, 0.1, (0.0, 0.0, 0.1), (0.001,) * 3, com_flange_m=(0.0, 0.0, 0.0)),))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "out.json"
    path.write_text(to_json(RESULT), encoding="utf-8")
    return path


def edited(path, change):
    body = json.loads(path.read_text(encoding="utf-8"))
    change(body)
    path.write_text(json.dumps(body, indent=3), encoding="utf-8")
    return path


def test_the_checksum_is_that_of_the_sorted_compact_form(file):
    body = json.loads(file.read_text(encoding="utf-8"))
    said = body.pop("sha256")
    compact = json.dumps(body, sort_keys=True, separators=(",", ":"))
    assert said == hashlib.sha256(compact.encode()).hexdigest()
    assert to_dict(RESULT)["sha256"] == said


def test_order_and_blanks_and_truth_do_not_matter(file):
    edited(file, lambda body: body.update({"truth": {"loads": []}, "schema": body.pop("schema")}))
    assert read_result(file).loads == RESULT.loads
    assert run("export", file, "--format", "kuka").exit_code == 0


@pytest.mark.parametrize(
    "change",
    [
        lambda body: body["loads"][0].update(mass_kg=-6.0),
        lambda body: body["loads"][0].update(mass_kg=6.001),
        lambda body: body.update(robot="other"),
        lambda body: body.update(more=1),
        lambda body: body.update(sha256="0" * 64),
        lambda body: body.update(sha256=None),
    ],
)
@pytest.mark.parametrize("command", ["export", "report", "bare"])
def test_an_edited_file_is_refused_with_the_reason(file, tmp_path, change, command):
    path = edited(file, change)
    words = {
        "export": ["export", path, "--format", "kuka"],
        "report": ["report", path, "-o", tmp_path / "page.html"],
        "bare": ["estimate", path.with_suffix(".csv"), "--bare", path],
    }
    done = run(*words[command])
    assert done.exit_code == 3
    assert "was edited" in done.stderr
    assert "write it again from the data" in " ".join(done.stderr.split())
    assert not (tmp_path / "page.html").exists()


def test_a_file_of_before_there_were_checksums_is_taken_and_named(file):
    done = run("export", edited(file, lambda body: body.pop("sha256")), "--format", "kuka")
    assert done.exit_code == 0
    assert "M 6.000," in done.stdout
    assert "has no sha256" in done.stderr


def test_what_is_written_again_carries_its_own_checksum(file):
    changed = edited(file, lambda body: body.update(robot="other"))
    again = from_json(changed.read_text(encoding="utf-8"))
    assert again.sha256 == to_dict(RESULT)["sha256"]
    changed.write_text(to_json(again), encoding="utf-8")
    assert read_result(changed).robot == "other"


def test_a_checksum_that_is_no_text_and_a_file_of_another_kind_are_refused(file):
    for key, value, said in (("sha256", 7, "expected text"), ("kind", "rest_plan", "not a result")):
        with pytest.raises(InputError, match=said):
            read_result(edited(file, lambda body, key=key, value=value: body.update({key: value})))
