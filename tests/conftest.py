"""For every test: its processor time, and neither a thread nor an open virtual CAN channel may be left behind.

Linear algebra runs in one thread, as in the programs themselves: several test processes share the cores.
"""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support.processor_time import FAST_LIMIT_S, Stopwatch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

#: Examples of a property test: few in the fast suite, more with `make test-slow`.
settings.register_profile("fast", max_examples=10, deadline=None)
settings.register_profile("slow", max_examples=100, deadline=None)
settings.load_profile("fast")


@pytest.fixture
def pages(monkeypatch):
    """Live pages that were started."""
    from gateway.live.page import LivePage

    started = []
    before = LivePage.__init__

    def noted(page, *arguments, **named) -> None:
        before(page, *arguments, **named)
        started.append(page)

    monkeypatch.setattr(LivePage, "__init__", noted)
    return started


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of a group on one worker, where what they share is made once; start the long ones first.

    pytest-xdist appends the group to the id of a test, by an attribute that pytest has since given another name: it
    is set here by the one that holds. Nothing is done where the id has it already.
    """
    if not getattr(config.option, "loadgroup", False):
        return
    items.sort(key=lambda item: item.path.parent.name != "system")
    for item in items:
        groups = sorted({str(mark.args[0]) for mark in item.iter_markers("xdist_group")})
        suffix = "@" + "_".join(groups)
        if groups and not item.nodeid.endswith(suffix):
            item._id = type(item._id).parse(item.nodeid + suffix)  # pyright: ignore


STOPWATCH = pytest.StashKey[Stopwatch]()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item):
    """Measure the processor time of a test, children included, without the fixtures that it shares with others."""
    item.config.stash[STOPWATCH] = Stopwatch()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef, request: pytest.FixtureRequest):
    """Take the set-up of a shared fixture out of the time of the test that happens to ask for it first."""
    if fixturedef.scope == "function":
        return (yield)
    with request.config.stash[STOPWATCH].paused():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo):
    """Note what a test took, and whether that is more than an unmarked test should take."""
    report = yield
    if call.when == "call":
        spent_s = item.config.stash[STOPWATCH].spent_s()
        if spent_s > FAST_LIMIT_S and not _may_be_slow(item):
            report.user_properties.append(("too_slow_s", spent_s))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List the tests to make cheaper or to mark; a machine under load fails no test."""
    for report in terminalreporter.getreports("passed"):
        if spent_s := dict(report.user_properties).get("too_slow_s"):
            terminalreporter.line(
                f"{report.nodeid} took {spent_s:.1f} s of processor time: make it cheaper or mark it slow"
            )


def _may_be_slow(item: pytest.Item) -> bool:
    """Whether a test is outside the fast suite: marked slow, on real vcan, or a property test with many examples.

    Tests on vcan run apart, most often in an emulated processor, whose speed the reference work does not predict.
    """
    many_examples = settings.get_current_profile_name() == "slow" and item.get_closest_marker("hypothesis")
    return bool(many_examples or item.get_closest_marker("slow") or item.get_closest_marker("vcan"))


# How long a thread that was commanded to end may take.
GRACE_S = 2.0
# Threads that libraries keep for the life of the process.
SHARED_THREADS = ("ThreadPoolExecutor", "pytest_timeout", "execnet")


def _threads() -> set[threading.Thread]:
    return {
        thread
        for thread in threading.enumerate()
        if thread is not threading.main_thread() and not thread.name.startswith(SHARED_THREADS)
    }


def _channels() -> set[str]:
    from can.interfaces.virtual import channels

    return {str(name) for name, queues in channels.items() if queues}


@pytest.fixture(autouse=True)
def leaves_nothing_behind():
    """Fail a test that leaks a thread or a virtual channel."""
    threads, channels = _threads(), _channels()
    yield
    deadline = time.monotonic() + GRACE_S
    while (left := _threads() - threads) and time.monotonic() < deadline:
        next(iter(left)).join(0.05)
    assert not left, f"threads left behind: {sorted(thread.name for thread in left)}"
    open_channels = _channels() - channels
    assert not open_channels, f"virtual channels left open: {sorted(open_channels)}"


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder of the measured runs of real robots."""
    folder = os.environ.get("SERVO_GATEWAY_DATA")
    if not folder:
        pytest.skip("SERVO_GATEWAY_DATA is not set: the measured runs of real robots are not at hand")
    return Path(folder)
