"""Options that several commands share: KEY=VALUE, known loads."""

from __future__ import annotations

import click
import pytest

from gateway.commands.shared_options import key_values, known_loads


def test_keys_and_values_are_taken_apart_once():
    assert key_values("--answer", (" a = 1, 2 ", "b=x=y", "a=3")) == {"a": "3", "b": "x=y"}


@pytest.mark.parametrize("pair", ["a", "=1"])
def test_what_has_no_key_or_no_value_is_a_usage_error(pair):
    with pytest.raises(click.UsageError, match=f"--answer '{pair}': write KEY=VALUE"):
        key_values("--answer", (pair,))


def test_a_known_load_that_is_stated_twice_is_a_usage_error():
    assert list(known_loads(("a=1", "b=2"))) == ["a", "b"]
    with pytest.raises(click.UsageError, match="twice"):
        known_loads(("a=1", "b=2", "a=3"))
