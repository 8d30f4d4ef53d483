"""Inject every fault, kill masters, feed strangers' bytes; print every figure with its goal and write `summary.json`.

python -m benchmarks.chaos [--out out/chaos] [scenarios] [truth] [kills] [stops] [stalls] [signals] [disk]
                     [io] [unbuffered] [pair_stops] [load] [fuzz] [sheets] [originals] [requests] [instants]
python -m benchmarks.chaos soak [--minutes 30]
"""

from __future__ import annotations

import importlib
import signal
from collections.abc import Iterable

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks.figure import conclude, write
from benchmarks.program import options

PARTS = (
    "scenarios",
    "truth",
    "kills",
    "stops",
    "stalls",
    "signals",
    "disk",
    "io",
    "unbuffered",
    "pair_stops",
    "load",
    "fuzz",
    "sheets",
    "originals",
    "requests",
    "instants",
)


def main() -> int:
    """Run the named parts (all but the soak by default); exit 1 when a goal is missed."""
    parser = options(__doc__, "out/chaos")
    words = "all but the soak if omitted"
    parser.add_argument("parts", nargs="*", choices=[*PARTS, "soak", PARTS], default=PARTS, help=words)
    parser.add_argument("--minutes", type=float, default=30.0, help="length of the soak")
    parser.add_argument("--kinds", default="", help="part scenarios: fault kinds to play, by commas; all if absent")
    parser.add_argument("--share", type=float, default=1.0, help="share of the full numbers, for a first look")
    arguments = parser.parse_args()
    figures: dict[str, dict] = {}
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # what `nohup` silences here would be silenced in the programs too
    columns = (TextColumn("{task.description:32s}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        for part in arguments.parts:
            module = importlib.import_module(f"benchmarks.chaos.part_{part}")
            figures |= module.figures(Scope(progress, arguments.share, arguments.minutes, arguments.kinds))
            write(figures, arguments.out)  # what is known so far
    return conclude(figures, arguments.out)


class Scope:
    """How much to run, and where to show progress."""

    def __init__(self, progress: Progress, share: float, minutes: float, kinds: str = "") -> None:
        self.minutes = minutes
        self.kinds = tuple(kind for kind in kinds.split(",") if kind)
        self.print = progress.console.print
        self._progress = progress
        self._share = share

    def count(self, full: int) -> int:
        """The share of a full number that is run, at least one."""
        return max(1, round(full * self._share))

    def complain(self, complaints: Iterable[str], about: str = "") -> None:
        """Print complaints, each behind what they are about."""
        for complaint in complaints:
            self.print(f"{about}: {complaint}" if about else complaint, markup=False)

    def bar(self, what: str, total: float) -> _Bar:
        """A progress bar with the remaining time."""
        return _Bar(self._progress, what, total)


class _Bar:
    def __init__(self, progress: Progress, what: str, total: float) -> None:
        self._progress = progress
        self._task = progress.add_task(what, total=total)

    def step(self, number: float = 1) -> None:
        """So much more is done."""
        self._progress.advance(self._task, number)


if __name__ == "__main__":
    raise SystemExit(main())
