"""Recordings and tables, mixed."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from gateway.cell.config import load_cell
from gateway.cell.conversion import AxisConversion
from gateway.data.recording.reader import read
from gateway.data.table import read_data, write_csv
from gateway.errors import InputError

EXAMPLE = Path(__file__).parents[3] / "examples" / "small" / "cell.toml"


@pytest.fixture
def path(tmp_path) -> Path:
    """A recording as others may write it: only what the format asks for."""
    text = EXAMPLE.read_text()
    random = np.random.default_rng(4)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.attrs.update(schema=1, created="today", cell=text, profiles="{}", robot="", software="other")
        file.attrs.update(exit_status="success", reason="")
        for number in range(1, 7):
            group = file.create_group(f"/arms/main/visits/{number:04d}")
            side = 1 if number % 2 else -1
            group.attrs.update(load="none", pose=(number + 1) // 2, approach=side, complete=True)
            group.attrs["direction"] = np.full(6, side)
            torque = random.normal(size=(5, 6))
            for name in ("statusword", "position_count", "torque_permille"):
                group[name] = np.ones((5, 6), dtype=int)
            for name in ("q_rad", "motor_torque_nm", "joint_torque_nm"):
                group[name] = torque
            group["sync_index"], group["time_s"] = np.arange(5), number + 0.01 * np.arange(5)
    return tmp_path / "run.h5"


def test_mixed_data(path, tmp_path):
    table = read(path).table()
    write_csv(table, tmp_path / "export.csv")
    back = read_data([tmp_path / "export.csv"], (), None)
    assert back.tau_nm == pytest.approx(table.tau_nm)
    both = read_data([path, tmp_path / "export.csv"], [read(path)], None)
    assert len(both) == 6  # the same visits, once


def test_contradicting_files_are_refused(path, tmp_path):
    table = read(path).table()
    write_csv(replace(table, tau_nm=table.tau_nm + 1), tmp_path / "export.csv")
    with pytest.raises(InputError, match=r"export.csv:2: repeats .*run.h5:1 .* another tau_nm"):
        read_data([path, tmp_path / "export.csv"], [read(path)], None)


def test_unknown_kinds_and_no_data(tmp_path):
    with pytest.raises(InputError, match="neither a recording"):
        read_data([tmp_path / "a.txt"], (), None)
    with pytest.raises(InputError, match="no measured data"):
        read_data([], (), None)


def test_tables_take_their_conversion_from_the_cell(tmp_path):
    names = ["pose", *(f"q{i}_rad" for i in range(1, 7)), "taum2_nm"]
    (tmp_path / "t.csv").write_text(",".join(names) + "\n1,0,0,0,0,0,0,0.5\n")
    cell = load_cell(EXAMPLE)
    axis = cell.cell.arm[0].axis[1]
    table = read_data([tmp_path / "t.csv"], (), AxisConversion.from_arm(cell.cell.arm[0]))
    assert table.tau_nm[0, 1] == pytest.approx(0.5 * axis.gear_ratio.value * axis.torque_sign)
    assert np.isnan(read_data([tmp_path / "t.csv"], (), None).tau_nm).all()
