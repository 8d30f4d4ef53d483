"""record --pose and --next: what was asked for is measured, from both sides, under numbers that stay."""

from __future__ import annotations

import json
import math

import pytest

POSE, OTHER = "0.1,-0.1,0.1,0.1,-0.1,0.1", "0.15,-0.05,0.15,0.05,-0.15,0.2"


def record(gateway, place, drives, *more):
    return gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes", *more)


def visits(place):
    (arm,) = place.recording().arms
    return sorted((visit.pose, visit.approach) for visit in arm.visits if visit.complete)


def asking(place, cell="small", poses=(OTHER,)):
    """A result that asks for poses."""
    path = place.folder / f"{cell}-{len(poses)}.json"
    wanted = [[float(value) for value in pose.split(",")] for pose in poses]
    seen = [{"pose": 4, "load": "none", "q_rad": [0.0] * 6}]
    body = {
        "schema": 1,
        "robot": "compact10",
        "loads": [],
        "next": [{"what": "measure", "poses_rad": wanted}],
        "data": {"cell": cell, "arm": "main", "poses": seen},
    }
    path.write_text(json.dumps(body), encoding="utf-8")
    return path


@pytest.mark.slow
def test_poses_and_what_a_result_asks_for_are_measured_also_once_more_by_number(place, gateway, serve, fast_arm):
    drives = fast_arm(serve())
    degrees = ",".join(str(math.degrees(float(value))) for value in POSE.split(","))
    done = record(gateway, place, drives, "--poses", f"{degrees}deg", "--poses", "8,-3,9,3,-9,12deg")
    assert done.exit_code == 0, done.output
    (arm,) = place.recording().arms
    assert arm.poses[0].q_rad == pytest.approx(tuple(map(float, POSE.split(","))))
    again = record(gateway, place, drives, "--poses", "1")
    assert again.exit_code == 0, again.output
    assert visits(place) == [(1, -1), (1, -1), (1, 1), (1, 1), (2, -1), (2, 1)]
    assert drives.stand_still()
    assert not [path for path in place.folder.iterdir() if "blackbox" in path.name], "every run has ended well"
    table = place.recording().table()  # a repeated visit is distinguished by its time
    assert sorted(table.pose.tolist()) == [1, 1, 1, 1, 2, 2]
    missing = record(gateway, place, drives, "--poses", "7")
    assert (
        missing.exit_code,
        "holds no pose 7 of arm 'main'; its poses are 1, 2" in " ".join(missing.output.split()),
    ) == (3, True)
    more = record(gateway, place, drives, "--next", asking(place), "--resume")
    assert more.exit_code == 0, more.output
    assert visits(place)[-2:] == [(5, -1), (5, 1)]
    (arm,) = place.recording().arms
    assert {pose.number: pose.q_rad for pose in arm.poses}[5] == pytest.approx((0.15, -0.05, 0.15, 0.05, -0.15, 0.2))


def test_what_cannot_be_meant_is_refused_before_the_bus_is_opened(place, gateway):
    without_drives = ("record", place.cell, "--bus", "virtual:empty", "--load", "none", "-o", place.run, "--yes")
    for more, code, says in (
        (("--poses", "0.1,0.2"), 2, "has 6 axes"),
        (("--poses", "0,30,0,0,30,0"), 2, "0,30,0,0,30,0deg"),
        (("--poses", "a,bdeg"), 2, "one joint angle per axis"),
        (("--poses", "7"), 3, "does not exist yet, so it has no pose of this number"),
        (("--poses", "7", "--poses", POSE), 2, "give one of them"),
        (("--poses", POSE, "--next", asking(place)), 2, "give one of them"),
        (("--next", asking(place, cell="other")), 3, "was made on cell 'other', not on 'small'"),
        (("--next", asking(place, poses=())), 3, "requests no pose"),
        (("--poses", "0,0,0,0,2.5,0"), 5, "joint 5 outside"),
    ):
        done = gateway(*without_drives, *more)
        assert done.exit_code == code, done.output
        assert says in " ".join(done.output.split())
