"""Drives as makes deliver them: interpolated position, node guarding, without objects that others have."""

from __future__ import annotations

import pytest

from benchmarks.makes import commissioned
from sim.fault import Fault

#: What the drives are like, as rows of the simulator's table.
AS_DELIVERED = (
    Fault("modes_supported", code=0x43),
    Fault("object_value", index=0x6007, code=3),
    *(Fault("object_absent", index=index, code=0x06020000) for index in (0x1016, 0x6007, 0x60B2)),
    *(Fault("object_absent", index=index, code=0x06010000) for index in (0x1019, 0x6502)),
    *(Fault("object_read_only", index=index, subindex=2) for index in range(0x1400, 0x1404)),
    Fault("status_bits_off", code=1 << 9),
    Fault("status_bits_on", code=1 << 11),
    Fault("warning_emcy", count=50, code=0x4390),
)


@pytest.mark.slow
def test_they_pass_the_check_prove_their_stop_and_weigh_a_load():
    """Six such drives, from their data sheet."""
    task = {"name": "as delivered", "makes": ["generic-cia402"] * 6, "rows": AS_DELIVERED, "in_sheet": True}
    run = commissioned(task | {"can_move": True, "reads": True, "measures": True})
    assert run["passed"], run["refused"]
    assert not run["powered"]
    assert run["off_std"] < 3.0
    assert {"cyclic_mode = 7", "ignored_status = 0x0800"} <= set(run["changed"])
