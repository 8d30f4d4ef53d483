"""Power cuts and kills lose no original value; and a ledger that is worse than ours is found out."""

from __future__ import annotations

import pytest

from benchmarks.chaos.originals import cut_in_process
from drives import access, ledger


@pytest.mark.slow
def test_no_original_is_lost_where_an_operation_is_the_last_one():
    found = cut_in_process(40, seed=11)
    assert (found.lost, found.complaints) == (0, [])
    assert len(found.by_kind) == 6


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["nothing is noted", "no record of the path back", "any value is the original"])
def test_a_worse_ledger_loses_originals(monkeypatch, fault):
    if fault == "nothing is noted":
        monkeypatch.setattr(ledger.WriteLedger, "note", lambda self, *entries: None)
    elif fault == "no record of the path back":
        monkeypatch.setattr(ledger.WriteLedger, "expect", lambda self, device, values: None)
        monkeypatch.setattr(ledger.WriteLedger, "confirm", lambda self, device, values: None)
        monkeypatch.setattr(ledger, "_keeps", lambda known, now, write: now == known.old)
    else:
        monkeypatch.setattr(access.LedgerEntry, "is_own", lambda self, value: False)
    assert cut_in_process(30, seed=11).lost > 0
