"""Stops of two arms that hold one part: along the path, by quick stop, by a fault, and by Ctrl-C at the terminal."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.chaos.part_pair_stops import stopped
from benchmarks.chaos.programs import TRIES, disturbed, undisturbed
from benchmarks.pair.bus_rig import CELL, NO_LIMIT_N, PairRig, inline_rig
from drives.errors import CommandRefused
from drives.files import read_sealed, write_sealed
from gateway.cli import main
from gateway.data.blackbox.box import read_box
from gateway.jobs.cell_context import locked_cell
from gateway.jobs.frame import Operator, stoppable
from gateway.jobs.pair import run_pair
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson
from gateway.pair.controller import EMBODIMENTS, with_gains
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import PairMotionOptions, PairStopped
from gateway.pair.pair_run import PairRun
from gateway.pair.pair_store import PairStore
from gateway.pair.servo_lag import ServoLag
from gateway.pair.session import cell_gains
from gateway.pair.transform_function import constant_function, function_of_knots
from sim.serve import free_bus
from sim.simulation import ServeOptions, Simulation
from sim.states import PdsState
from tests.support.rigs.pacing import by_the_clock, in_lockstep

#: Real drives take each target in its time; simulated ones that got round to two of them at once do not [s].
SIMULATOR_DELAY_S = 0.02


def rig_at_rest(rig: PairRig, name: str = "B", limit_n: float | None = NO_LIMIT_N, speed: float = 1.5) -> PairRun:
    """A row at the start of the path, gripped, powered."""
    config = with_gains(EMBODIMENTS[name], cell_gains(rig.cell))
    return rig.run(config, constant_function(rig.cell.nominal_relation), PairMotionOptions(speed, None, limit_n))


def enabled(rig: PairRig) -> list[bool]:
    """Which of the twelve follow setpoints."""
    drives = [drive for unit in rig.simulation.arms for drive in unit.drives]
    return [drive.automaton.state is PdsState.OPERATION_ENABLED for drive in drives]


def at_time(rig: PairRig, after_s: float, act: Callable[[], Any]) -> None:
    """Do something once, so many simulated seconds from now."""
    due = [rig.world.time_s + after_s]

    def look(time_s: float) -> None:
        if due and time_s >= due[0]:
            due.clear()
            act()

    rig.world.after.append(look)


def kinds_of(desk: StopDesk) -> list[StopKind]:
    """Kinds of all wishes from now on."""
    kinds: list[StopKind] = []
    plain = desk.ask

    def ask(cause: BaseException, kind: StopKind = StopKind.ALONG_PATH) -> None:
        kinds.append(kind)
        plain(cause, kind)

    desk.ask = ask  # type: ignore[method-assign]
    return kinds


@pytest.mark.slow
def test_a_stop_along_the_path_keeps_the_relation() -> None:
    """Below some 20 N joints that come to rest hide what acts between the hands."""
    done = stopped("along the path", 0, 2.1)
    assert done.after_n < 1.2 * max(done.before_n, 20.0)
    assert done.off_after_m < max(1.2 * done.off_before_m, 1e-4)


@pytest.mark.slow
def test_drives_are_disabled_when_the_joints_no_longer_catch_up() -> None:
    with inline_rig(0) as rig:
        run = rig_at_rest(rig)
        at_time(rig, 1.5, lambda: run.motion.stream.options.desk.ask(StoppedByPerson("stopped")))
        fastest: list[float] = []

        def note(_time_s: float) -> None:
            if not any(enabled(rig)):
                fastest.append(float(np.abs(rig.world.motors.omega).max()))

        rig.world.after.append(note)
        begin_s = rig.world.time_s + 1.5
        with pytest.raises(StoppedByPerson):
            rig.power.attempt(run.cycle)
        assert rig.world.time_s > begin_s
    assert fastest[0] < 0.01


@pytest.mark.slow
def test_a_second_wish_is_a_quick_stop_of_all_twelve() -> None:
    with inline_rig(0) as rig:
        run, left = rig_at_rest(rig), []
        desk, period_s = run.motion.stream.options.desk, rig.cell.sync_period_s
        asked: list[float] = []

        def quickly() -> None:
            asked.append(rig.world.time_s)
            desk.ask(StoppedByPerson("again"), StopKind.QUICK_STOP)

        at_time(rig, 1.5, lambda: desk.ask(StoppedByPerson("stopped")))
        at_time(rig, 1.5 + 5 * period_s, quickly)
        rig.world.after.append(lambda time_s: left.append((time_s, sum(enabled(rig)))))
        with pytest.raises(StoppedByPerson, match="stopped"):
            rig.power.attempt(run.cycle)
        begun = next(time_s for time_s, count in left if time_s > asked[0] and count < 12)
        assert begun - asked[0] <= 3 * period_s
        assert not any(enabled(rig))


@pytest.mark.slow
def test_a_force_that_still_rises_becomes_a_quick_stop() -> None:
    with inline_rig(0) as rig:
        run = rig_at_rest(rig, "A", 20.0)
        kinds = kinds_of(run.motion.stream.options.desk)
        begin_s = rig.world.time_s + 0.9
        pull = np.zeros(12)

        def snag(_ticks: int) -> None:
            pull[6:] = rig.world.part.at(rig.world.q).jacobian[1, 6:]
            rig.world.push = pull * 1500.0 * max(0.0, rig.world.time_s - begin_s)

        rig.world.before.append(snag)
        with pytest.raises(PairStopped, match="above 40 N for more than 20 ms"):
            rig.power.attempt(run.cycle)
    assert kinds[0] is StopKind.ALONG_PATH
    assert kinds.count(StopKind.ALONG_PATH) == 1
    assert StopKind.QUICK_STOP in kinds


@pytest.mark.slow
def test_a_force_that_does_not_rise_any_more_is_no_quick_stop() -> None:
    with inline_rig(0) as rig:
        run = rig_at_rest(rig, "B", 15.0)
        kinds = kinds_of(run.motion.stream.options.desk)
        with pytest.raises(PairStopped, match="above 30 N"):
            rig.power.attempt(run.cycle)
    assert kinds == [StopKind.ALONG_PATH]


@pytest.mark.slow
def test_a_part_that_is_held_elsewhere_is_detected_during_the_transfer_to_the_start() -> None:
    """A grasp that is 2 mm wrong, the part still held: 300 N if both arms went there."""
    with inline_rig(0) as rig:
        run = rig_at_rest(rig, "B", 40.0)
        wrong = rig.cell.nominal_relation.copy()
        wrong[0, 3] += 2e-3
        again = PairRun(rig.cell, run.motion.stream, run.config, constant_function(wrong), run.motion.options)
        rig.world.recording = True
        with pytest.raises(PairStopped, match="during the approach to the start, above 20 N: .* check the grasp"):
            rig.power.attempt(again.cycle)
        rig.world.catch_up(0)
    assert np.linalg.norm(np.array(rig.world.record)[:, 1:4], axis=1).max() < 80.0


@pytest.mark.slow
def test_an_arm_with_impossible_commands_stops_both() -> None:
    with inline_rig(0) as rig:
        run = rig_at_rest(rig)
        member = run.motion.stream.arms.members[1]
        plain = member.command

        def jump() -> None:
            member.command = lambda q, *rest: plain(q + 1.0, *rest)  # type: ignore[method-assign]

        at_time(rig, 1.5, jump)
        states: list[set[PdsState]] = []
        drives = [drive for unit in rig.simulation.arms for drive in unit.drives]
        rig.world.after.append(lambda _time_s: states.append({drive.automaton.state for drive in drives}))
        with pytest.raises(CommandRefused):
            rig.power.attempt(run.cycle)
    followed, stopping = PdsState.OPERATION_ENABLED, PdsState.QUICK_STOP_ACTIVE
    assert any(stopping in seen and followed not in seen for seen in states)
    assert PdsState.OPERATION_ENABLED not in states[-1]


@pytest.mark.parametrize(("ahead", "gain_1_s"), [(0.8, 12.5), (0.0, 60.0), (0.5, 25.0)])
def test_servos_that_slow_down_stay_as_far_behind_as_they_were(ahead: float, gain_1_s: float) -> None:
    dt_s = 0.004
    lag = ServoLag(dt_s, (1.0 - ahead) / gain_1_s, 12)
    speed = np.linspace(-1.0, 1.0, 12)
    at, y, rate, before = np.zeros(12), np.zeros(12), 1.0, np.zeros(12)
    behind = []
    for cycle in range(700):
        wanted = min(1.0, cycle / 100.0) if cycle < 400 else max(0.0, 1.0 - (cycle - 400) / 60.0)
        rate = wanted if cycle >= 400 else 1.0
        at = at + dt_s * wanted * speed
        lag.slow_down(rate)
        sent = at - lag.given_back(speed) if lag.slower else at
        lag.take((sent[:6], sent[6:]), (_Seen(y[:6]), _Seen(y[6:])), speed)
        step = sent - before
        for _ in range(40):
            y = y + dt_s / 40 * (gain_1_s * (before - y) + ahead * step / dt_s)
            before = before + step / 40
        before = sent
        if cycle == 399 or cycle == 699:
            behind.append(at - y)
    assert np.abs(behind[1] - behind[0]).max() < 0.1 * np.abs(behind[0]).max()


class _Seen:
    """What six drives showed."""

    def __init__(self, q_rad: np.ndarray) -> None:
        self.q_rad = q_rad


@pytest.fixture
def example(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """The example at 20 ms, taught; its text is changed, and its path has that many rows."""
    folder, (paced, rows) = tmp_path / "pair", request.param
    shutil.copytree(CELL.parent, folder, ignore=shutil.ignore_patterns("*.pair"))
    path, cell = folder / "path.csv", folder / "cell.toml"
    path.write_text("".join(path.read_text(encoding="utf-8").splitlines(keepends=True)[: rows + 1]), encoding="utf-8")
    text = paced(cell.read_text(encoding="utf-8"))
    cell.write_text(text.replace("sync_period_s = 0.004", "sync_period_s = 0.02"), encoding="utf-8")
    pair = load_pair(cell)
    function = function_of_knots([0.0, pair.path().length_m], np.stack([pair.nominal_relation] * 2))
    PairStore(pair, cell.with_suffix(".pair")).save("first", function, learn_source="taught", speed=0.0)
    return cell


@pytest.mark.slow
@pytest.mark.parametrize("example", [(in_lockstep, 50)], indirect=True)
def test_two_arms_are_asked_for_and_their_first_motion_is_slow(example: Path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(example.parent / "state"))
    buses = ";".join(f"{arm}=virtual:{arm}-{example.parent}" for arm in ("left", "right"))

    def fastest(*words: str, answer: str | None = None, code: int = 0) -> float:
        """Speed of the fastest motor during a command; the part is gripped afresh at the very start."""
        with serving(example, buses) as simulation:
            if "--prove-stop" in words:
                simulation.grip(open=True)
            done = CliRunner().invoke(main, [*words, "--bus", buses], input=answer)
            assert done.exit_code == code, done.output
            assert answer is None or "Arms 'left' and 'right' of cell 'pair' are at the start" in done.output
            drives = [drive for unit in simulation.arms for drive in unit.drives]
            assert not any(drive.automaton.energised for drive in drives)
            return max(axis.fastest_rad_s for axis in simulation.arms[0].world.motors.axes)

    fastest("check", str(example), "--prove-stop", "--yes")
    run = ("pair", "run", str(example), "--variant", "A")
    assert fastest(*run, answer="n\n", code=130) < 1e-3
    first, asked = fastest(*run, "--yes"), list[str]()
    operator = Operator(ask=lambda what, _meanwhile: asked.append(what))
    with serving(example, buses) as simulation, locked_cell(example, buses) as context, stoppable() as options:
        result = run_pair(context, "A", operator, options)
    assert (len(result.cycles), len(asked)) == (1, 1)
    later = max(axis.fastest_rad_s for axis in simulation.arms[0].world.motors.axes)
    assert first == pytest.approx(0.1 * later, rel=0.3)


@pytest.mark.slow
@pytest.mark.clock
@pytest.mark.parametrize("example", [(by_the_clock, 301)], indirect=True)
def test_ctrl_c_by_the_clock_stops_both_along_the_path(example: Path) -> None:
    buses = f"left={free_bus()};right={free_bus()}"
    gateway = [sys.executable, "-m", "gateway.cli"]
    settings = os.environ | {"XDG_STATE_HOME": str(example.parent / "state")}
    with serving(example, buses) as simulation:
        simulation.grip(open=True)
        prove([*gateway, "check", str(example), "--prove-stop", "--yes", "--bus", buses], settings)
    for path in example.parent.glob("state/servo-gateway/*-stop.json"):  # as if they had moved: not at a tenth
        write_sealed(path, read_sealed(path) | {"moved": True})
    words = [*gateway, "pair", "run", str(example), "--variant", "A", "--yes", "--bus", buses]
    before: set[Path] = set()
    for left in reversed(range(TRIES)):
        before = boxes_of(example)
        # gripped afresh at the very start: where a proof leaves the hands the part would be under force
        with serving(example, buses) as simulation:
            seen = interrupt(simulation, words, settings)
        busy = disturbed(seen.said) or seen.simulator_s > SIMULATOR_DELAY_S
        if left == 0 or not busy or (seen.code in (0, 130) and not seen.quick):
            break
    assert seen.code == 130, seen.said
    assert seen.said.strip().splitlines()[-1].startswith("stopped by SIGINT: ")
    assert "Traceback" not in seen.said
    assert not seen.powered
    assert not seen.quick
    boxes = [read_box(path) for path in sorted(boxes_of(example) - before)]
    assert len(boxes) == 2
    for box, arm in zip(boxes, load_pair(example).arms, strict=True):
        assert [held.name for held in box.arms] == [arm.config.name]
        assert len(box.time_s) > 10
        assert box.path.name in seen.said.replace("\n", "")


def boxes_of(cell: Path) -> set[Path]:
    """What is kept of the last seconds before each stop so far."""
    return set(cell.parent.glob("state/servo-gateway/*.blackbox.h5"))


def prove(words: list[str], settings: dict[str, str]) -> None:
    """Have the stop proven; tried again while this computer is too busy for the clock."""

    def check() -> tuple[int, str]:
        done = subprocess.run(words, check=False, capture_output=True, text=True, env=settings, timeout=120.0)
        return done.returncode, done.stdout + done.stderr

    code, said = undisturbed(check)
    assert code == 0, said


@contextmanager
def serving(cell: Path, buses: str) -> Iterator[Simulation]:
    """The pair in real time, in a thread."""
    simulation = Simulation(cell, ServeOptions(bus=buses))
    thread = threading.Thread(target=simulation.run, name="pair-sim")
    thread.start()
    try:
        yield simulation
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


@dataclass(frozen=True)
class Interrupted:
    """What became of a command that was interrupted.

    `powered`: a drive was left under power; `quick`: a quick stop was seen; `simulator_s`: by how much the simulated
    drives were delayed at most [s].
    """

    code: int
    said: str
    powered: bool
    quick: bool
    simulator_s: float


def interrupt(simulation: Simulation, words: list[str], settings: dict[str, str]) -> Interrupted:
    """Start a command, send SIGINT once the arms move, and wait for its end."""
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=settings)
    drives = [drive for unit in simulation.arms for drive in unit.drives]
    world: Any = simulation.arms[0].world
    quick: list[bool] = []
    try:
        until_s = time.monotonic() + 120.0
        while np.abs(world.motors.omega).max() < 0.2 and time.monotonic() < until_s and process.poll() is None:
            time.sleep(0.02)
        world.after.append(
            lambda _time_s: quick.append(any(d.automaton.state is PdsState.QUICK_STOP_ACTIVE for d in drives))
        )
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=20.0)
    finally:
        process.kill()
    powered = any(drive.axis.fed or drive.axis.free for drive in drives)
    delay_s = max(server.latest_s for server in simulation.servers)
    return Interrupted(process.returncode, said, powered, any(quick), delay_s)
