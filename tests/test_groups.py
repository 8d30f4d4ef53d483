"""Tests of a group run on one worker, which pytest-xdist reads from their ids."""

from __future__ import annotations

import pytest


@pytest.mark.xdist_group("dealt")
@pytest.mark.parametrize("place", ["first", "second"])
def test_the_id_of_a_test_contains_its_group_where_tests_are_dealt_out_by_it(request, place):
    dealt_out = getattr(request.config.option, "loadgroup", False)
    assert request.node.nodeid.endswith("@dealt") is dealt_out, place
