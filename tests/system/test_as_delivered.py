"""Drives as makes deliver them: interpolated position, node guarding, without objects that others have."""

from __future__ import annotations

import json

import pytest

from drives.profile_file import load_profile
from sim.fault import Fault
from sim.faults import act

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
#: What their profile says of it.
CHANGES = (
    ('name = "generic-cia402"', 'name = "bench"'),
    ('eds = "generic-cia402.eds"\n', ""),
    ("[state_machine]", "[state_machine]\ncyclic_mode = 7\nignored_status = 0x0800"),
    ("consumer_ms = 500\nabort_connection = 3\nproducer_ms = 100", 'watchdog = "node guarding"\nconsumer_ms = 500'),
    ("0x1006, 0x1016,", "0x1006, 0x100C, 0x100D,"),
    ("0x6007, 0x6040,", "0x6040,"),
    ("0x607A, 0x60B1, 0x60B2, 0x60C2", "0x60C0, 0x60C1, 0x60C2"),
)
WARNING = '\n[[emcy]]\ncode = 0x4390\ntext = "warm"\nadvice = "check the fan"\nwarning = true\n'


@pytest.fixture
def bench(place, serve):
    """Six such drives with their profile."""
    text = load_profile("generic-cia402").text + WARNING
    text = text[: text.index("[feedforward]")] + text[text.index("[state_machine]") :]
    for old, new in CHANGES:
        assert old in text, old
        text = text.replace(old, new, 1)
    (place.folder / "bench.toml").write_text(text, encoding="utf-8")
    cell = place.cell.read_text(encoding="utf-8").replace('"generic-cia402"', '"bench"')
    place.cell.write_text(cell, encoding="utf-8")

    def start(pacing):
        place.cell.write_text(cell.replace('pacing = "lockstep"', f'pacing = "{pacing}"'), encoding="utf-8")
        drives = serve(pacing=pacing)
        for row in AS_DELIVERED:
            act(drives.handle.simulation.arms[0].drives, row)
        return drives

    return start


@pytest.mark.slow
def test_they_pass_the_check_prove_their_stop_and_weigh_a_load(place, bench, gateway):
    drives = bench("lockstep")
    checked = gateway("check", place.cell, "--bus", drives.bus, "--json", "-")
    assert checked.exit_code == 0, checked.output
    for load in ("none", "gripper"):
        drives.mount(load)
        run = place.folder / f"{load}.h5"
        done = gateway("record", place.cell, "--bus", drives.bus, "--load", load, "-o", run, "--yes")
        assert done.exit_code == 0, done.output
        assert drives.stand_still()
    result = place.folder / "result.json"
    done = gateway("estimate", place.folder / "none.h5", place.folder / "gripper.h5", "--json", result)
    assert done.exit_code == 0, done.output
    (load,) = json.loads(result.read_text(encoding="utf-8"))["loads"]
    truth = drives.handle.simulation.loads["gripper"]
    assert abs(load["mass_kg"] - truth.mass_kg) < 3.0 * load["mass_std_kg"]


@pytest.mark.slow
@pytest.mark.clock
@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_their_stop_without_the_master_is_proven_before_they_move(place, bench, gateway, pacing):
    drives = bench(pacing)
    done = gateway("check", place.cell, "--bus", drives.bus, "--prove-stop", "--yes", "--json", "-")
    assert done.exit_code == 0, done.output
    said = [each["what"] for each in json.loads(done.stdout)["findings"] if each["severity"] == "ok"]
    assert sum("left OPERATION ENABLED after" in what for what in said) == 6
    assert drives.stand_still()
