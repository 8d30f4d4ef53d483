"""Both arms of a pair, connected and configured on their two buses."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gateway.motion.arms import Arms
from gateway.motion.opening import BusOverride, OpenArm, open_arm
from gateway.motion.state import StateKeeper
from gateway.motion.stream import MoveOptions, Station
from gateway.pair.cell import PairCell
from gateway.pair.gap import instruments_on


class PairLink:
    """Both arms.

    Parameters
    ----------
    opened : master and slave
    together : the same under one clock
    """

    def __init__(self, opened: tuple[OpenArm, OpenArm], together: Arms) -> None:
        self.opened, self.together = opened, together

    def station(self, cell: PairCell, options: MoveOptions) -> Station:
        """What the motion loop works with."""
        return Station(
            arms=self.together,
            workspaces=tuple(each.workspace for each in self.opened),
            period_s=cell.sync_period_s,
            state=StateKeeper(" and ".join(each.config.name for each in self.opened), lambda _state: None),
            options=options,
        )

    def statistics(self) -> dict[str, Any]:
        """Cycles, incomplete epochs, lateness and skew so far."""
        skew = np.array(self.together.skew_s) if self.together.skew_s else np.zeros(1)
        groups = [each.group.statistics for each in self.opened]
        return {
            "pacing": "real" if self.together.real else "lockstep",
            "cycles": [group.cycles for group in groups],
            "incomplete": [group.incomplete for group in groups],
            "late": [group.late for group in groups],
            "skew_s": {
                "median": float(np.median(skew)),
                "p99": float(np.percentile(np.abs(skew), 99)),
                "max": float(np.abs(skew).max()),
            }
            if self.together.real
            else None,
        }


@contextmanager
def open_link(cell: PairCell, ledgers: tuple[Path | None, Path | None] = (None, None)) -> Generator[PairLink]:
    """Connect and configure both arms; on leaving all drives are disabled and both buses closed.

    Raises
    ------
    ConfigError, DriveError
        As `open_arm`.
    """
    with ExitStack() as opened:
        arms = []
        for arm, spec, ledger in zip(cell.arms, cell.specs, ledgers, strict=True):
            beside = instruments_on(arm.config.bus, cell.config)
            override = BusOverride(spec=spec, ledger=ledger, instruments=beside)
            arms.append(opened.enter_context(open_arm(cell.loaded, override, arm.config.name)))
        together = Arms([each.arm for each in arms], cell.pacing)
        opened.callback(together.close)
        yield PairLink((arms[0], arms[1]), together)
