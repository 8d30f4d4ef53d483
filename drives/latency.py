"""Statistics of the SDO responses of one node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

#: Upper edges of the latency histogram, s; the last bin is open.
LATENCY_EDGES_S: Final = (0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True, slots=True)
class SdoStatistics:
    """Latency of the SDO responses of one node, and numbers of failed requests.

    Attributes
    ----------
    node_id : int
    count : int
        Answers in time.
    mean_s, max_s : float
        Of their latency.
    histogram : tuple of int
        Answers per bin; upper edges `LATENCY_EDGES_S`, the last bin is open.
    timeouts, late, foreign, aborts : int
        Requests without an answer; answers after their time-out; answers without a request; refusals.
    """

    node_id: int
    count: int
    mean_s: float
    max_s: float
    histogram: tuple[int, ...]
    timeouts: int
    late: int
    foreign: int
    aborts: int
