"""The pair that keeps a gap by distance sensors: over both buses, and what is refused before them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.pair.bus_gap import GapRig, gap_rig
from drives.errors import ConfigurationRefused
from gateway.motion.stops import StopKind
from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import PairStopped
from sim.states import PdsState
from tests.benchmarks.pair.test_stops import kinds_of
from tests.gateway.pair.test_pair_commands import EXAMPLE, call, edit

FAST = 3.0


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    folder = tmp_path / "pair"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("*.pair"))
    return folder / "distance.toml"


# ------------------------------------------------------------------------------------------------------ on both buses


@pytest.mark.slow
def test_one_cycle_brings_the_gap_home_and_is_learned_from() -> None:
    with gap_rig(1) as rig:
        plain = rig.run("A", FAST)
        free, off = rig.cycle(plain)
        plain.back()
        rig.power.off()
        run = rig.run("E5", FAST)
        done, kept = rig.cycle(run)
        rig.power.off()
    assert np.abs(off).max() > 1e-3
    assert np.abs(kept).max() < 0.5 * np.abs(off).max()
    assert done.summary.learned
    assert done.summary.gap_m == pytest.approx(np.abs(kept).max(), abs=30e-6)
    assert np.isnan(done.summary.force_n)
    assert not free.summary.learned
    # what is read at a SYNC is the true distance at that SYNC, to noise and resolution
    assert np.abs(done.gaps_m - kept).max() < 30e-6


def lost_at(rig: GapRig, after_s: float, cycles: float) -> None:
    """From now on in some seconds, the frames of so many cycles stay away."""
    begins_s, transmit = rig.world.time_s + after_s, rig.device.transmit

    def gap(time_s: float) -> None:
        lost = begins_s < time_s < begins_s + cycles * rig.cell.sync_period_s
        rig.device.transmit = (lambda _tpdo: None) if lost else transmit  # type: ignore[method-assign]

    rig.world.after.append(gap)


@pytest.mark.slow
def test_a_missing_frame_is_no_value_and_never_the_old_one() -> None:
    with gap_rig(0) as rig:
        run = rig.run("E5", FAST)
        lost_at(rig, 1.5, 1.5)
        done, _ = rig.cycle(run)
        statistics = rig.link.statistics()
        rig.power.off()
    without = np.isnan(done.gaps_m).all(axis=1)
    assert 1 <= without.sum() <= 2
    assert not np.isnan(done.gaps_m[~without]).any()
    assert not done.summary.learned
    assert "no gap could be determined" in done.summary.reason
    assert statistics.incomplete == (0, 0)


def stop_responding(rig: GapRig) -> None:
    rig.device.node.unpowered = True


def sees_nothing(rig: GapRig) -> None:
    rig.device.measure = lambda: [0.02, 0.02, float("nan"), 0.02, 0.02, 0.02]


def is_too_far(rig: GapRig) -> None:
    rig.device.measure = lambda: [0.02, 0.02, 0.02, 0.036, 0.02, 0.02]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("harm", "said", "kind"),
    [
        (stop_responding, "no distances for 5 cycles, its frames are missing", StopKind.ALONG_PATH),
        (sees_nothing, "no distances for 5 cycles, sensor 3 reports no valid value", StopKind.ALONG_PATH),
        (is_too_far, "sensor 4 measures 36.00 mm, its range is 5 to 35 mm", StopKind.QUICK_STOP),
    ],
)
def test_sensors_that_fail_stop_both_arms_along_the_path_and_a_gap_outside_its_range_at_once(
    harm: Callable[[GapRig], None], said: str, kind: StopKind
) -> None:
    with gap_rig(0) as rig:
        run = rig.run("E5", FAST)
        kinds = kinds_of(run.motion.stream.options.desk)
        harm(rig)
        with pytest.raises(PairStopped, match=said):
            rig.power.attempt(run.cycle)
        states = [drive.automaton.state for arm in rig.arms for drive in arm.drives]
    assert kinds[0] is kind
    assert len(states) == 12
    assert PdsState.OPERATION_ENABLED not in states


# --------------------------------------------------------------------------------------------------- before the buses


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('bus = "right"\nnode_id = 21', 'bus = "middle"\nnode_id = 21', "none of the pair's"),
        ("node_id = 21", "node_id = 3", "is a drive's"),
        ("lsb_m = 1e-6", "lsb_m = 1e-6\nlsb_mm = 1e-3", "unknown key"),
        ("lsb_m = 1e-6", "", "lsb_m is missing"),
        ("range_m = [0.005, 0.035]", "range_m = [0.025, 0.035]", "gap_m of channel 1 is outside"),
        ("subindex = 2", "subindex = 1", "subindex has the same entry twice"),
        ("beam = [0, 0, 1]", "beam = [0, 0, 0]", "is not a direction"),
        ("part_mass_kg = 5.0", "part_mass_kg = 5.0\nforce_limit_n = 40.0", "omit it"),
        ('components = ["x",', 'components = ["w",', "components"),
        ("beam = [0, 1, 0]", "beam = [1, 0, 0]", "6 sensors do not determine component 'y'"),
    ],
)
def test_a_cell_whose_sensors_cannot_be_used_is_refused(cell: Path, old: str, new: str, said: str) -> None:
    edit(cell, old, new)
    result = call("pair", "run", cell, "--variant", "E5", "--yes")
    assert result.exit_code == 3
    assert said in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_fewer_sensors_than_components_are_refused_and_fewer_components_are_not(cell: Path) -> None:
    text = cell.read_text(encoding="utf-8")
    start, end = text.index("[[pair.distance.channel]]\nsubindex = 4"), text.index("[[arm]]")
    cell.write_text(text[:start] + text[end:], encoding="utf-8")
    result = call("pair", "run", cell, "--variant", "E5", "--yes")
    assert result.exit_code == 3
    assert "3 sensors do not determine component" in result.output
    edit(cell, '["x", "y", "z", "rx", "ry", "rz"]', '["z", "rx", "ry"]')
    gap = load_pair(cell).gap
    assert gap is not None
    # fingertip 2 points down, gripper 1 too: 1 mm more along the beams is 1 mm to go
    assert np.allclose(np.abs(gap.estimator.error(np.full(3, 0.021))), [0, 0, 1e-3, 0, 0, 0], atol=1e-12)


def test_more_channels_than_four_frames_carry_are_refused(cell: Path) -> None:
    text = cell.read_text(encoding="utf-8")
    more = "".join(
        f"[[pair.distance.channel]]\nsubindex = {n}\nat_m = [0.0, 0.0, 0.0]\nbeam = [0, 0, 1]\ngap_m = 0.02\n\n"
        for n in (7, 8, 9)
    )
    cell.write_text(text.replace("[[arm]]", more + "[[arm]]", 1), encoding="utf-8")
    with pytest.raises(ConfigurationRefused, match="9 channels need"):
        load_pair(cell)


def test_rows_and_cells_that_do_not_fit_are_refused(cell: Path) -> None:
    result = call("pair", "run", cell.with_name("cell.toml"), "--variant", "E5", "--yes")
    assert result.exit_code == 3
    assert "[pair.distance]" in result.output
    result = call("pair", "run", cell, "--variant", "C8", "--yes")
    assert result.exit_code == 3
    assert "choose E5" in result.output
    result = call("pair", "teach", cell, "--yes")
    assert result.exit_code == 3
    assert "pair run --variant E5" in result.output


def test_the_report_shows_the_gap_in_millimetres(cell: Path) -> None:
    folder = cell.with_suffix(".pair")
    folder.mkdir()
    cycles = [{"gap_m": 0.3e-3, "knots": 100}, {"gap_m": 0.075e-3, "knots": 100}]
    run = {"name": "E5", "text": "gap", "speed": 1.5, "s_m": [0.0, 0.5], "x_m": [0.7, 0.9], "knots_s_m": [0.0]}
    run |= {"first_m": [0.1e-3, -0.3e-3], "last_m": [0.075e-3, None], "cycles": cycles}
    (folder / "run-E5.json").write_text(json.dumps(run), encoding="utf-8")
    output = cell.parent / "report.html"
    assert call("pair", "report", cell, "-o", output).exit_code == 0
    page = output.read_text(encoding="utf-8")
    for said in ("gap error [mm]", "first cycle [mm]", ">0.300</td>", ">0.075</td>", "<svg"):
        assert said in page
    assert "Nm" not in page
