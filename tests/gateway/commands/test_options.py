"""Options that several commands share: KEY=VALUE, known loads."""

from __future__ import annotations

import click
import pytest

from gateway.commands.shared_options import key_values, known_loads


def test_keys_and_values_are_taken_apart_once():
    assert key_values("--answer", (" a = 1, 2 ", "b=x=y", "a=3")) == {"a": "3", "b": "x=y"}


@pytest.mark.parametrize(
    ("pair", "keys", "says"), [("a", (), "KEY=VALUE"), ("=1", (), "KEY=VALUE"), ("c=1", ("a", "b"), "one of a, b")]
)
def test_what_has_no_key_or_another_one_is_a_usage_error(pair, keys, says):
    with pytest.raises(click.UsageError, match=says) as caught:
        key_values("--answer", (pair,), keys)
    assert f"--answer '{pair}'" in str(caught.value)


def test_a_known_load_that_is_stated_twice_is_a_usage_error():
    assert list(known_loads(("a=1", "b=2"))) == ["a", "b"]
    with pytest.raises(click.UsageError, match="twice"):
        known_loads(("a=1", "b=2", "a=3"))
