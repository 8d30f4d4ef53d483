"""One make and two drawn ones are commissioned, and what became of the make is in the page on drives."""

import json

import pytest

from benchmarks.makes import main


@pytest.mark.slow
def test_a_make_weighs_its_load_and_drawn_ones_prove_their_stop(tmp_path):
    assert main(["--makes", "maxon-epos4", "--drawn", "2", "--out", str(tmp_path)]) == 0
    (run,) = map(json.loads, (tmp_path / "makes.jsonl").read_text().splitlines())
    assert [step["step"] for step in run["steps"]] == ["profiles", "check", "check", "record", "record", "estimate"]
    assert len((tmp_path / "drawn.jsonl").read_text().splitlines()) == 2
