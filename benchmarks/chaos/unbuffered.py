"""Drives that take each setpoint over when it comes, however irregularly, moved by every command."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.chaos.programs import (
    PAIR_PERIOD_S,
    TRIES,
    Command,
    Stage,
    disturbed,
    pair_bus,
    pair_stage,
    prove,
    small_stage,
    teach,
)

#: What is known of wall-clock drives without a buffer is known after so long under power [s].
LONGEST_S = 40.0


@dataclass(slots=True)
class Fastest:
    """How fast axes became.

    Attributes
    ----------
    shares : by command, largest true speed as a share of that axis's limit
    disturbed : runs that this computer was too busy for; they count as well
    """

    shares: dict[str, float] = field(default_factory=dict)
    disturbed: int = 0
    complaints: list[str] = field(default_factory=list)


def fastest_unbuffered(
    period_s: float, commands: Sequence[Command], progress: Callable[[], None] = lambda: None
) -> Fastest:
    """Let commands move drives that do not buffer setpoints, to their end or for `LONGEST_S`.

    Parameters
    ----------
    period_s : float
        SYNC period.
    commands : sequence of Command
    progress : callable
        Called after each.
    """
    fastest = Fastest()
    with tempfile.TemporaryDirectory(prefix="unbuffered-") as name:
        folder = Path(name)
        single = [command for command in commands if not command.pair]
        if single:
            with small_stage(folder / "small", period_s, unbuffered=True) as stage:
                for command in single:
                    stage.served.ask("renew")
                    _run(command, stage, folder / "out", fastest)
                    progress()
        double, bus = [command for command in commands if command.pair], pair_bus()
        if double:
            with pair_stage(folder / "pair", min(period_s, PAIR_PERIOD_S), bus, unbuffered=True) as stage:
                prove(stage)
        for command in double:
            with pair_stage(folder / "pair", min(period_s, PAIR_PERIOD_S), bus, unbuffered=True) as stage:
                shutil.rmtree(stage.cell.with_suffix(".pair"), ignore_errors=True)
                teach(stage)
                _run(command, stage, folder / "out", fastest)
                progress()
    return fastest


def _run(command: Command, stage: Stage, out: Path, fastest: Fastest) -> None:
    code, said = None, ""
    for _ in range(TRIES):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        stage.served.ask("logs")
        program = stage.run(*command.words(stage, out))
        program.wait_for(lambda: False, LONGEST_S)
        if program.code is None:
            program.send(2)
        code, said = program.end(), program.said
        share = max(track.share(0.0) for track in stage.served.ask("logs"))
        fastest.shares[command.name] = max(share, fastest.shares.get(command.name, 0.0))
        if not disturbed(said):
            break
        fastest.disturbed += 1
        if not stage.pair:
            stage.served.ask("renew")
    # a commissioning waits for a load that is not mounted, a part that was run for a while is interrupted
    if code not in (0, 130):
        fastest.complaints.append(f"{command.name}: exit code {code}: ...{said[-300:]}")
