"""pytest plugin: write the processor time of every test and shared fixture into the folder that TEST_TIMES names."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.support.processor_time import Stopwatch


def _write(row: dict[str, object]) -> None:
    file = Path(os.environ["TEST_TIMES"]) / f"times-{os.getpid()}.jsonl"
    with file.open("a", encoding="utf-8") as log:
        log.write(json.dumps(row) + "\n")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef, request: pytest.FixtureRequest):
    """One row for each shared fixture."""
    watch = Stopwatch()
    result = yield
    if fixturedef.scope != "function":
        where = fixturedef.baseid or "tests"
        _write({"fixture": f"{where}::{fixturedef.argname}", "file": where, "spent_s": watch.spent_s()})
    return result


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo):
    """One row for each test that ran."""
    report = yield
    spent = dict(report.user_properties).get("processor_time_s")
    if call.when == "call" and spent is not None:
        _write({"test": item.nodeid, "spent_s": spent})
    return report
