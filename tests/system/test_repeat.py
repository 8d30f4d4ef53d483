"""`commission --repeat`: a measurement of its own per repetition, at other poses and remounted, and their summary."""

from __future__ import annotations

import json

import pytest

from gateway.data.recording.reader import read
from tests.system.conftest import with_few_poses


@pytest.mark.slow
def test_a_load_is_measured_twice_and_a_third_time_later(place, serve, commission, fast_arm):
    with_few_poses(place)
    drives = fast_arm(serve())
    code, result, hands, output = commission(drives, "--repeat", "2")
    assert code == 0, output.err
    assert result is None, "every repetition has a folder of its own"
    assert hands.asked == ["load", "none", "load"], "the load is removed for the unloaded arm of the second repetition"
    out = place.folder / "out"
    first, second = (read(out / number / "run.h5").arm("main").poses for number in ("01", "02"))
    assert {pose.q_rad for pose in first[:4]}.isdisjoint(pose.q_rad for pose in second[:4])
    found = json.loads((out / "repeatability.json").read_text())
    assert found["kind"] == "repeatability"
    assert [row["what"].split()[0] for row in found["quantities"]] == ["mass", "centre", "centre", "centre"]
    mass = found["quantities"][0]
    stored = [json.loads((out / number / "result.json").read_text())["loads"][0] for number in ("01", "02")]
    assert mass["value"] == [load["mass_kg"] for load in stored]
    assert mass["expected"] < mass["stated"], "torque constants and link masses are common to both"
    assert found["verdict"] == "cannot tell", "two values do not limit a standard deviation"
    assert "Repeatability" in (out / "repeatability.html").read_text()

    before = (out / "01" / "run.h5").read_bytes()
    code, _, hands, output = commission(drives, "--repeat", "3", "--resume")
    assert code == 0, output.err
    assert hands.asked == ["none", "load"], "what is measured is not measured again"
    assert (out / "01" / "run.h5").read_bytes() == before
    assert json.loads((out / "repeatability.json").read_text())["quantities"][0]["repetition"] == [1, 2, 3]
