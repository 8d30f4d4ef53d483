"""Both arms of a pair, connected and configured on their two buses."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from gateway.data.disk import Disk
from gateway.motion.arms import Arms
from gateway.motion.opening import OpenArm, open_arm
from gateway.motion.stream import MoveOptions, Stream
from gateway.pair.gap import instruments_on
from gateway.pair.pair_cell import PairCell
from gateway.result.pair import LinkStatistics, Skew


class PairLink:
    """Both arms of a pair, connected to their buses.

    Parameters
    ----------
    opened : master and slave
    together : the same under one clock
    """

    def __init__(self, opened: tuple[OpenArm, OpenArm], together: Arms) -> None:
        self.opened, self.together = opened, together

    def stream(self, cell: PairCell, options: MoveOptions) -> Stream:
        """Return the stream of both arms."""
        return Stream(self.together, tuple(each.workspace for each in self.opened), cell.sync_period_s, options)

    def statistics(self) -> LinkStatistics:
        """Return the counters of both buses so far."""
        first, second = (each.group.statistics for each in self.opened)
        return LinkStatistics(
            pacing="real" if self.together.real else "lockstep",
            cycles=(first.cycles, second.cycles),
            incomplete=(first.incomplete, second.incomplete),
            late=(first.late, second.late),
            skew_s=_skew(self.together.skew_s) if self.together.real else None,
        )


def _skew(skew_s: Sequence[float]) -> Skew:
    skew = np.array(skew_s) if skew_s else np.zeros(1)
    size = np.abs(skew)
    return Skew(float(np.median(skew)), float(np.percentile(size, 99)), float(size.max()))


@contextmanager
def open_link(cell: PairCell, ledger: Path | None = None) -> Generator[PairLink]:
    """Connect and configure both arms; on leaving all drives are disabled and both buses closed.

    Raises
    ------
    ConfigError, DriveError
        As `open_arm`.
    """
    with ExitStack() as opened:
        arms, disk = [], opened.enter_context(Disk())
        for arm, spec in zip(cell.arms, cell.specs, strict=True):
            on_bus, name = instruments_on(arm.config.bus, cell.config), arm.config.name
            opening = open_arm(
                cell.loaded, spec, name, ledger=ledger, offsets=("torque",), instruments=on_bus, disk=disk
            )
            arms.append(opened.enter_context(opening))
        together = Arms([each.arm for each in arms], cell.pacing)
        opened.callback(together.close)
        yield PairLink((arms[0], arms[1]), together)
