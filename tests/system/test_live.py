"""The live page on a run over the bus: seen and stopped in a browser, and watched from beside it."""

from __future__ import annotations

import _thread
import json
import os
import signal
import threading
from collections.abc import Callable

import can
import numpy as np
import pytest
from websockets.sync.client import connect

from benchmarks.chaos.programs import TRIES, disturbed
from benchmarks.live.parts import commands, quick_stop_at
from drives.bus import BusSpec, open_bus
from drives.listen_only import ListenOnlyBus
from gateway.cell.config import load_cell
from gateway.cell.conversion import AxisConversion
from gateway.live.page import LivePage
from gateway.motion.arm import JointSide
from gateway.motion.opening import axis_setups
from sim.serve import running
from tests.support.pages.browser import MISSING, Browser, available, browser
from tests.support.processes import wait_until
from tests.support.rigs.proofs import keep_proof_of_stop

PATIENCE_S = 60.0
#: SYNC period and encoder of the small cell.
PERIOD_S, COUNTS_PER_MOTOR_RAD = 0.01, 65536 / (2 * np.pi)
WIDE, NARROW = (1280, 900), (390, 844)
DRAWN = """
const canvas = document.querySelector("canvas");
const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
let drawn = 0;
for (let at = 3; at < data.length; at += 4) drawn += data[at] > 200;
return drawn;
"""


class Watcher(threading.Thread):
    """Does something with the page of a run, beside it; a run that it fails on is interrupted."""

    def __init__(self, pages: list[LivePage], look: Callable[[LivePage], None]) -> None:
        super().__init__(daemon=True)
        self._pages, self._look = pages, look
        self.failure: BaseException | None = None

    def run(self) -> None:
        try:
            wait_until(lambda: self._pages)
            self._look(self._pages[0])
        except BaseException as error:
            self.failure = error
            _thread.interrupt_main()


@pytest.mark.slow
@pytest.mark.skipif(not available(), reason=MISSING)
def test_a_person_sees_the_arm_and_stops_it_by_a_click(place, serve, gateway, pages, tmp_path):
    drives = serve()
    seen: dict[str, object] = {}

    def look(page: LivePage) -> None:
        with browser() as window:
            window.resize(*WIDE)
            window.visit(page.address)
            clicked(window)

    def clicked(window: Browser) -> None:
        wait_until(lambda: window.run("return document.getElementById('phase').textContent") == "moving")
        wait_until(lambda: window.run("return live.arms[0].time.length > 100"))
        seen["drawn"] = window.run(DRAWN)
        seen["axes"] = window.run(
            "return [...document.querySelectorAll('.axes td:first-child')].map(e => e.textContent)"
        )
        seen["units"] = window.run("return document.querySelector('.axes thead').innerText")
        seen["rows"] = window.run("return live.arms[0].time.length")
        for scheme in ("light", "dark"):
            window.in_light(scheme)
            window.picture(tmp_path / f"{scheme}.png")
            window.resize(*NARROW)
            seen[scheme] = window.run("return [document.documentElement.scrollWidth, innerWidth]")
            window.picture(tmp_path / f"{scheme}-narrow.png")
            window.resize(*WIDE)
        window.run("document.getElementById('stop').click()")
        wait_until(lambda: not window.run("return document.getElementById('over').hidden"))
        seen["over"] = window.run("return document.getElementById('over').textContent")
        seen["disabled"] = window.run("return document.getElementById('stop').disabled")

    watcher = Watcher(pages, look)
    watcher.start()
    # so slow that the run is never over before the click
    done = gateway(
        *("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes"),
        *("--live", "--override", "5"),
    )
    watcher.join(PATIENCE_S)
    if watcher.failure is not None:
        raise watcher.failure
    assert done.exit_code == 130, done.output
    assert "stopped by the button of the live page" in done.output
    assert drives.stand_still()
    assert seen["drawn"] > 5000  # type: ignore[operator]
    assert seen["axes"] == [f"J{axis}" for axis in range(1, 7)]
    assert all(unit in str(seen["units"]) for unit in ("rad", "rad/s", "mrad", "Nm"))
    assert seen["rows"] > 100  # type: ignore[operator]
    for scheme in ("light", "dark"):
        wide, screen = seen[scheme]  # type: ignore[misc]
        assert wide <= screen
        assert (tmp_path / f"{scheme}-narrow.png").stat().st_size > 20_000
    assert (tmp_path / "light.png").read_bytes() != (tmp_path / "dark.png").read_bytes()
    assert "stopped by the button of the live page" in str(seen["over"])
    assert seen["disabled"] is True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pacing", "number", "problem"),
    [
        ("lockstep", signal.SIGSTOP, "has not answered for 2 s"),
        ("lockstep", signal.SIGKILL, "has ended"),
        pytest.param("real", signal.SIGSTOP, "has not answered for 2 s", marks=pytest.mark.clock),
    ],
)
def test_an_arm_whose_page_freezes_or_dies_is_stopped_along_its_path(
    place, gateway, pages, tmp_path_factory, pacing, number, problem
):
    cell = place.variant(pacing, ('pacing = "lockstep"', f'pacing = "{pacing}"'))

    def strike(page: LivePage) -> None:
        """Send the signal once the page has shown a moving arm for a second: five heartbeats."""
        shown = 0
        with connect(page.address.replace("http", "ws").replace("/?", "/feed?"), open_timeout=PATIENCE_S) as messages:
            while shown < 30:
                shown += json.loads(messages.recv(PATIENCE_S)).get("frame", {}).get("phase") == "moving"
        os.kill(page.process.pid, number)

    with running(cell, payload=place.payload) as drives:
        keep_proof_of_stop(cell, drives.bus, tmp_path_factory)
        wanted = ("record", cell, "--bus", drives.bus, "--load", "none", "--yes", "--live")
        for attempt in range(TRIES):
            pages.clear()
            trace = place.folder / f"{attempt}.log"
            watcher = Watcher(pages, strike)
            watcher.start()
            # so slow that the run is over in minutes only: the signal comes first
            done = gateway(*wanted, "-o", place.folder / f"{attempt}.h5", "--override", "5", "--trace", trace)
            watcher.join(PATIENCE_S)
            if not disturbed(done.output):
                break
    assert watcher.failure is None
    assert done.exit_code == 5, done.output
    text = " ".join(done.output.split())
    assert f"the process of the live page {problem}, so its stop button does not work; start again" in text
    assert "every drive was read as disabled" in text
    with can.LogReader(str(trace)) as frames:
        rows = commands(frames)
    steps = np.diff([target for _, _, target in rows])
    # the brakes close by a quick stop where an axis still trembles, once the setpoints have come to rest
    assert (quick_stop_at(rows, 0.0) or np.inf) > rows[1 + np.flatnonzero(steps)[-1]][0]
    # setpoints slow down as fast as the axis may, they do not end suddenly; each is rounded to a count
    ramps = [axis.acceleration_rad_s2 * axis.gear_ratio.value for axis in load_cell(cell).cell.arm[0].axis]
    assert np.abs(np.diff(steps)).max() < max(ramps) * PERIOD_S**2 * COUNTS_PER_MOTOR_RAD + 2


@pytest.mark.slow
def test_a_page_leaves_with_its_command(place, serve, gateway, pages):
    drives = serve()
    done = gateway("move", place.cell, "--bus", drives.bus, "--to", "home", "--yes", "--live")
    assert done.exit_code == 0, done.output
    (page,) = pages
    assert page.address in done.output.replace("\n", "")
    assert page.process.poll() == 0
    assert not page.feed.gone


@pytest.mark.slow
def test_what_is_received_beside_a_run_is_what_the_run_has_recorded(place, serve, gateway):
    drives = serve()
    loaded = load_cell(place.cell)
    (config,) = loaded.cell.arm
    with open_bus(BusSpec.parse(drives.bus)) as bus:
        listener = ListenOnlyBus(bus, axis_setups(loaded, config))
        assert listener.unknown == tuple(axis.node_id for axis in config.axis)
        stop, epochs = threading.Event(), []

        def listen() -> None:
            while not stop.is_set():
                bus.listen(0.01)
                epochs.extend(listener.epochs())

        beside = threading.Thread(target=listen)
        beside.start()
        try:
            wanted = ("--load", "none", "-o", place.run, "--yes", "--poses", "0.1,0,0.2,0,0.1,0")
            done = gateway("record", place.cell, "--bus", drives.bus, *wanted)
        finally:
            stop.set()
            beside.join()
    assert done.exit_code == 0, done.output
    assert listener.unknown == ()
    side = JointSide(AxisConversion.from_arm(config))
    received_q = {tuple(side.sample(epoch).q_rad.tolist()) for epoch in epochs if epoch.complete}
    arm = place.recording().arms[0]
    for visit in arm.visits:
        for q_rad in visit.q_rad[::7]:
            assert tuple(q_rad.tolist()) in received_q
