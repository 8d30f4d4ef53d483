"""One make and a drawn one are commissioned, and what became of the make is in the page on drives."""

import json

import pytest

from benchmarks.makes import main


@pytest.mark.slow
def test_a_make_weighs_its_load_and_a_drawn_one_proves_its_stop(tmp_path):
    assert main(["--makes", "maxon-epos4", "--drawn", "1", "--out", str(tmp_path)]) == 0
    (run,) = map(json.loads, (tmp_path / "makes.jsonl").read_text().splitlines())
    assert [step["step"] for step in run["steps"]] == ["profiles", "check", "check", "record", "record", "estimate"]
    assert len((tmp_path / "drawn.jsonl").read_text().splitlines()) == 1
