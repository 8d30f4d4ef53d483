"""Drives whose profile says that they are read and not moved: scan and check read them, nothing moves them."""

from __future__ import annotations

import pytest

from drives.profile_file import list_profiles, load_profile

NOT_MOVED = [name for name in list_profiles() if load_profile(name).obstacles]


def test_there_are_such_profiles_and_others():
    assert NOT_MOVED
    assert len(NOT_MOVED) < len(list_profiles())


def with_profile(place, name):
    text = place.cell.read_text(encoding="utf-8").replace('"generic-cia402"', f'"{name}"')
    place.cell.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("name", NOT_MOVED)
def test_every_motion_is_refused_with_the_reason_before_anything_is_sent(name, place, gateway):
    with_profile(place, name)
    recorded = gateway("record", place.cell, "--bus", "virtual:empty", "--load", "none", "-o", place.run, "--yes")
    assert recorded.exit_code == 3, recorded.output
    said = " ".join(recorded.output.split())
    assert f"J1, J2, J3, J4, J5, J6: profile {name} refuses motion" in said
    assert all(obstacle in said for obstacle in load_profile(name).obstacles)
    assert not place.run.exists()
