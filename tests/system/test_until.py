"""record --until and commission --until over the bus: no longer than needed, and what is refused before that."""

from __future__ import annotations

import json

import pytest

TRUTH_KG, TRUTH_COM_M = 6.0, (0.02, 0.01, 0.10)


def record(gateway, place, bus, load, *more):
    return gateway("record", place.cell, "--bus", bus, "--load", load, "-o", place.run, "--yes", *more)


@pytest.mark.slow
def test_a_load_is_measured_until_it_is_known(place, gateway, serve, fast_arm):
    drives = fast_arm(serve())
    bare = record(gateway, place, drives.bus, "none")
    assert bare.exit_code == 0, bare.output
    drives.mount("load")
    summary = place.folder / "until.json"
    done = record(gateway, place, drives.bus, "load", "--resume", "--until", "mass=20%,com=15mm", "--json", summary)
    assert done.exit_code == 0, done.output
    assert "is measured pose by pose" not in done.output, "with --yes nothing is asked"
    assert "load load has reached the requested uncertainty after" in done.output
    until = json.loads(summary.read_text())["until"]
    assert until["reached"] is True
    assert until["mass_half_width_kg"] <= until["mass_goal_kg"] == pytest.approx(0.2 * TRUTH_KG, rel=0.1)
    assert max(until["com_half_width_m"]) <= 0.015
    (arm,) = place.recording().arms
    chosen = sorted({visit.pose for visit in arm.visits if visit.load == "load"})
    assert chosen == list(range(7, 7 + until["poses"])), "numbers beyond those of the cell's poses"
    assert {pose.number for pose in arm.poses} >= set(chosen), "the file names what was measured"
    assert drives.stand_still()

    estimated = gateway("estimate", place.run, "--json", "-")
    (load,) = json.loads(estimated.stdout)["loads"]
    assert 1.96 * load["mass_std_kg"] == pytest.approx(until["mass_half_width_kg"], rel=0.02)
    assert abs(load["mass_kg"] - TRUTH_KG) < 4 * load["mass_std_kg"]
    again = record(gateway, place, drives.bus, "load", "--resume", "--until", "mass=20%,com=15mm")
    assert again.exit_code == 0, again.output
    assert "nothing new under load load" in again.output


def test_what_cannot_be_meant_is_refused_before_the_bus_is_opened(place, gateway):
    for load, more, code, says in (
        ("load", ("--until", "mass=1%", "--poses", "0,0,0,0,0,0"), 2, "give one of them"),
        ("load", ("--bare", "r.json"), 2, "give --until as well"),
        ("load", ("--until", "mass=1%", "--bare", place.folder / "none.json"), 3, "none.json"),
    ):
        done = record(gateway, place, "virtual:empty", load, *more)
        assert done.exit_code == code, (more, done.output)
        assert says in " ".join(done.output.split()), (more, done.output)


@pytest.mark.slow
def test_the_whole_job_measures_a_load_until_it_is_known(serve, commission, fast_arm):
    drives = fast_arm(serve())
    code, result, hands, output = commission(drives, "--until", "mass=20%,com=15mm")
    assert code == 0, output.err
    assert hands.asked == ["load"]
    (load,) = result["loads"]
    assert abs(load["mass_kg"] - TRUTH_KG) < 4 * load["mass_std_kg"]
    assert result["holdout_kind"] == "fresh"
    (said,) = [
        each for each in result["findings"] if each["where"] == "load load" and "requested uncertainty" in each["what"]
    ]
    assert said["severity"] == "info"
    assert drives.stand_still()
