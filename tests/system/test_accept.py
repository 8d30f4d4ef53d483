"""accept on simulated drives: poses are chosen, the arm moves as it is asked to, a wrong load fails."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from benchmarks.chaos.programs import undisturbed
from gateway.data.recording.reader import read
from gateway.data.rows import concatenate
from gateway.data.table import read_csv, write_csv
from sim.serve import running
from tests.data.resting_arm import two_sided
from tests.support.rigs.proofs import keep_proof_of_stop


@pytest.mark.slow
def test_a_right_load_passes_and_a_wrong_one_fails(place, serve, gateway, fast_arm, identified_by_table):
    drives = fast_arm(serve())
    drives.mount("load")
    out = place.folder / "accepted"
    where = ("--bus", drives.bus, "-o", out)
    words = ["accept", place.cell, identified_by_table, "--tolerance", "5%", *where]
    refused = gateway(*words, input="n\n")
    assert refused.exit_code == 130, refused.output
    assert "has to be mounted" in refused.output
    assert not (out / "accept.h5").exists()

    done = gateway(*words, "--yes", "--json", place.folder / "a.json")
    assert done.exit_code == 0, done.output
    assert drives.stand_still()
    answer = json.loads((place.folder / "a.json").read_text())
    assert (answer["outcome"], answer["load"], answer["arm"]) == ("pass", "load", "main")
    assert 2 <= len(answer["poses"]) <= 12
    seen_rad = read_csv(place.folder / "seen.csv", None).q_rad
    for pose in read(out / "accept.h5").arms[0].poses:
        assert np.abs(seen_rad - pose.q_rad).max(axis=1).min() > 0.1, "a pose that no fit has seen"

    drives.mount("none")
    done = gateway(*words, "--yes", "--json", place.folder / "b.json")
    assert done.exit_code == 7, done.output
    answer = json.loads((place.folder / "b.json").read_text())
    assert (answer["outcome"], answer["likeliest_error"]) == ("fail", "load")


@pytest.mark.slow
@pytest.mark.clock
def test_a_right_load_passes_in_real_time(place, fast_arm, gateway, identified_by_table, tmp_path_factory):
    """The drives run in a process of their own over UDP; the result is that of a run in lockstep."""
    cell = place.variant("real", ('pacing = "lockstep"', 'pacing = "real"'))
    out = place.folder / "accepted"
    with running(cell, payload=place.payload) as drives:
        drives.mount("load")
        keep_proof_of_stop(cell, drives.bus, tmp_path_factory)
        words = ["accept", cell, identified_by_table, "--tolerance", "5%", "--bus", drives.bus, "--yes"]

        def accept() -> tuple[int, str]:
            shutil.rmtree(out, ignore_errors=True)
            done = gateway(*words, "-o", out, "--json", place.folder / "a.json")
            return done.exit_code, done.output

        code, said = undisturbed(accept)
    assert code == 0, said
    answer = json.loads((place.folder / "a.json").read_text())
    assert (answer["outcome"], answer["load"]) == ("pass", "load")
    recording = read(out / "accept.h5")
    assert recording.exit_status == "success"
    # the clock of the computer, not the next answer: SYNCs are a period apart
    times = np.concatenate([np.diff(visit.time_s) for visit in recording.arms[0].visits])
    assert np.median(times) == pytest.approx(recording.cell.bus["a"].sync_period_s, rel=0.05)


def test_a_tolerance_within_the_noise_is_refused_before_anything_moves(place, serve, gateway, identified_by_table):
    drives = serve()
    out = place.folder / "accepted"
    words = [identified_by_table, "--tolerance", "0.01%", "--bus", drives.bus, "-o", out, "--yes"]
    done = gateway("accept", place.cell, *words)
    assert done.exit_code == 5, done.output
    assert "too small for the noise" in " ".join(done.output.split())
    assert not (out / "accept.h5").exists()


@pytest.fixture
def identified_by_table(place, gateway):
    """A result of the small arm from a table, without a bus."""
    # mass and centre of gravity as in the payload file
    seen = [two_sided("none", None), two_sided("load", (6.0, 0.02, 0.01, 0.10), start_s=300.0)]
    write_csv(concatenate(seen), place.folder / "seen.csv")
    done = gateway("estimate", place.folder / "seen.csv", "--cell", place.cell, "--json", place.folder / "r.json")
    assert done.exit_code == 0, done.output
    return place.folder / "r.json"
