"""The measured table: what is read is what the file says, and everything else is refused by file and line."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.cell.conversion import AxisConversion
from gateway.data.table import Table, concatenate, read_csv, write_csv
from gateway.errors import InputError

Q = [f"q{i}_rad" for i in range(1, 7)]
QD = [f"qd{i}_rad_s" for i in range(1, 7)]
QDD = [f"qdd{i}_rad_s2" for i in range(1, 7)]
TAU = [f"tau{i}_nm" for i in range(1, 7)]


def rest_rows(n_rows: int = 3, **more: list) -> dict[str, list]:
    """Columns of a small valid table at rest."""
    random = np.random.default_rng(0)
    columns: dict[str, list] = {"pose": list(range(1, n_rows + 1))}
    columns |= {name: random.uniform(-1, 1, n_rows).round(6).tolist() for name in (*Q, *TAU)}
    return columns | more


def write(path: Path, columns: dict[str, list]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def conversion(**changes: np.ndarray) -> AxisConversion:
    values = {
        "ratio": np.array([100.0, 120.0, -80.0, 60.0, 50.0, 40.0]),
        "efficiency": np.full(6, 0.8),
        "position_sign": np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0]),
        "torque_sign": np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0]),
        "zero_offset_rad": np.zeros(6),
        "torque_constant_nm_per_a": np.array([1.8, 1.8, 1.5, 0.5, 0.4, 0.3]),
        "coupling": np.eye(6),
    }
    return AxisConversion(**(values | changes))


def test_reads_rest_rows(tmp_path):
    columns = rest_rows(load=["none", "a", "a"], dir2=[1, -1, 0], n=[10, 20, 30], tau2_std_nm=[0.1, 0.2, 0.3])
    table = read_csv(write(tmp_path / "t.csv", columns), None)
    assert len(table) == 3
    assert table.pose.tolist() == [1, 2, 3]
    assert table.load.tolist() == ["none", "a", "a"]
    assert table.run.tolist() == ["t", "t", "t"]
    assert table.line.tolist() == [2, 3, 4]
    assert not table.moving.any()
    assert np.array_equal(table.q_rad, np.array([columns[name] for name in Q]).T)
    assert np.array_equal(table.tau_nm, np.array([columns[name] for name in TAU]).T)
    assert not table.qd_rad_s.any()
    assert not table.qdd_rad_s2.any()
    assert table.direction[:, 1].tolist() == [1, -1, 0]
    assert table.count.tolist() == [10, 20, 30]
    assert table.tau_std_nm[:, 1].tolist() == [0.1, 0.2, 0.3]
    assert np.isnan(table.tau_std_nm[:, [0, 2, 3, 4, 5]]).all()
    assert np.isnan(table.time_s).all()
    assert np.isnan(table.q2nd_rad).all()


def test_defaults_are_those_of_the_format(tmp_path):
    table = read_csv(write(tmp_path / "t.csv", rest_rows()), None)
    assert table.load.tolist() == ["none"] * 3
    assert table.count.tolist() == [1, 1, 1]
    assert not table.direction.any()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_byte_order_mark_line_ends_quoting_and_column_order_do_not_matter(tmp_path, encoding, line_end):
    columns = rest_rows(load=["a, b", "ä", "none"])
    plain = read_csv(write(tmp_path / "plain.csv", columns), None)
    names = list(reversed(columns))
    lines = [",".join(f'"{name}"' for name in names)]
    lines += [",".join(f'"{columns[name][row]}"' for name in names) for row in range(3)]
    path = tmp_path / "other.csv"
    path.write_bytes((line_end.join(lines) + line_end * 2).encode(encoding))
    other = read_csv(path, None)
    assert np.array_equal(plain.q_rad, other.q_rad)
    assert np.array_equal(plain.tau_nm, other.tau_nm)
    assert other.load.tolist() == ["a, b", "ä", "none"]


def test_moving_rows(tmp_path):
    columns = rest_rows()
    del columns["pose"]
    columns |= {name: [0.1, 0.2, 0.3] for name in (*QD, *QDD)} | {"time_s": [0.0, 0.1, 0.2]}
    table = read_csv(write(tmp_path / "t.csv", columns), None)
    assert table.moving.all()
    assert table.pose.tolist() == [-1, -1, -1]
    assert table.qd_rad_s[:, 3].tolist() == [0.1, 0.2, 0.3]


def test_rest_and_moving_rows_in_one_file(tmp_path):
    columns = rest_rows(pose=[1, "", ""], time_s=["", 0.1, 0.2])
    columns |= {name: ["", 0.0, 0.3] for name in (*QD, *QDD)}
    table = read_csv(write(tmp_path / "t.csv", columns), None)
    assert table.moving.tolist() == [False, True, True]
    assert table.pose.tolist() == [1, -1, -1]
    assert table.qd_rad_s[:, 0].tolist() == [0.0, 0.0, 0.3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tau1_Nm": [1, 2, 3]}, ":1: unknown column 'tau1_Nm'"),
        ({"tau3_nm": [0, "1_0", 1]}, ":3: tau3_nm: '1_0' is not a finite number"),
        ({"tau3_nm": [0, "1,5", 1]}, ":3: tau3_nm: '1,5' is not a finite number"),
        ({"x_own": [0, "NaN", 1]}, ":3: x_own: 'NaN' is not a finite number"),
        ({"pose": [1, -2, 3]}, ":3: pose: -2 is not an integer"),
        ({"pose": [1, "", 3]}, ":3: a row at rest needs a pose number"),
        ({"pose": None}, ":2: a row at rest needs a pose number"),
        ({"dir1": [0, 1, 2]}, ":4: dir1: 2 is not one of -1, 0"),
        ({"n": [1, 0, 1]}, ":3: n: 0 is not an integer of at least 1"),
        ({"tau1_std_nm": [1, -1, 1]}, ":3: tau1_std_nm is negative"),
        ({"taum1_std_nm": [1, 1, 1]}, ":1: column 'taum1_std_nm' has no column 'taum1_nm'"),
        ({"taum1_nm": [1, 1, 1]}, ":1: axis 1 is given as tau1_nm and taum1_nm"),
        ({"qd1_rad_s": [1, 1, 1]}, "column 'time_s' is missing"),
        ({"time_s": [1, 2, 3], "qd1_rad_s": [1, 1, 1]}, "column 'qd2_rad_s' is missing"),
        ({"time_s": [1, 2, 3]} | {n: [0, 1, 0] for n in QD}, "column 'qdd1_rad_s2' is missing (row at line 3)"),
        ({"time_s": [1, 2, 3]} | {n: [0, 1, 0] for n in QD} | {n: [0, "", 0] for n in QDD}, ":3: qdd1_rad_s2 is empty"),
        ({"time_s": [1, "", 3]} | {n: [0, 1, 0] for n in (*QD, *QDD)}, ":3: time_s is empty"),
    ],
)
def test_refused_by_file_and_line(tmp_path, change, message):
    columns = {name: cells for name, cells in (rest_rows() | change).items() if cells is not None}
    with pytest.raises(InputError) as refused:
        read_csv(write(tmp_path / "bad.csv", columns), None)
    assert str(refused.value).startswith(str(tmp_path / "bad.csv"))
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", ":1: the file is empty"),
        (b"\n\n", ":1: the file is empty"),
        (b"pose,q1_rad\n", ":1: the table has a header but no row"),
        (b"pose,pose\n1,1\n", ":1: column 'pose' is given twice"),
        (b"pose;q1_rad\n1;2\n", "the separator must be a comma"),
        (b"pose,q1_rad\n1\n", ":2: 1 cells where the header names 2 columns"),
        (b"pose,q1_rad\n1,2,3\n", ":2: 3 cells where the header names 2 columns"),
        (b'pose,q1_rad\n1,"2\n', "not valid CSV"),
        (b"pose,q1_rad\n1,\xff\n", "not UTF-8 text"),
        (b"pose,q1_rad\n1," + b"9" * 200_000 + b"\n", "not valid CSV: field larger"),
    ],
)
def test_malformed_text_is_refused(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_bytes(text)
    with pytest.raises(InputError) as refused:
        read_csv(path, None)
    assert message in str(refused.value)


def test_missing_file_and_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path / "none.csv", None)
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path, None)


def test_duplicate_rows_that_differ_are_refused(tmp_path):
    columns = rest_rows(4)
    for name in ("pose", *Q):
        columns[name][3] = columns[name][1]
    with pytest.raises(InputError, match=r"bad.csv:5: repeats .*bad.csv:3 .*another tau_nm"):
        read_csv(write(tmp_path / "bad.csv", columns), None)


def test_equal_duplicate_rows_count_once(tmp_path):
    columns = rest_rows(3)
    for cells in columns.values():
        cells.append(cells[1])
    assert read_csv(write(tmp_path / "t.csv", columns), None).pose.tolist() == [1, 2, 3]


@pytest.mark.parametrize("apart", [{"time_s": [0, 10, 20]}, {"dir1": [1, -1, 1]}, {"load": ["none", "a", "b"]}])
def test_repeated_visits_are_kept_when_something_distinguishes_them(tmp_path, apart):
    columns = rest_rows(pose=[1, 1, 2]) | apart
    assert len(read_csv(write(tmp_path / "t.csv", columns), None)) == 3


def test_motor_torques_are_taken_to_the_joint(tmp_path):
    axes = conversion()
    columns = {name: cells for name, cells in rest_rows().items() if name not in TAU}
    columns |= {"taum2_nm": [1.0, 2.0, 3.0], "taum5_nm": [1.0, 1.0, 1.0], "taum2_std_nm": [0.1, 0.1, 0.1]}
    table = read_csv(write(tmp_path / "t.csv", columns), axes)
    assert table.tau_nm[:, 1] == pytest.approx([120.0, 240.0, 360.0])
    assert table.tau_nm[:, 4] == pytest.approx([-50.0, -50.0, -50.0])
    assert np.isnan(table.tau_nm[:, [0, 2, 3, 5]]).all()
    assert table.tau_std_nm[:, 1] == pytest.approx([12.0, 12.0, 12.0])
    assert table.motor_torque_nm[:, 1].tolist() == [1.0, 2.0, 3.0]
    without = read_csv(tmp_path / "t.csv", None)
    assert np.isnan(without.tau_nm).all()
    assert without.motor_torque_nm[:, 1].tolist() == [1.0, 2.0, 3.0]


def test_currents_use_the_torque_constant(tmp_path):
    columns = {name: cells for name, cells in rest_rows().items() if name not in TAU}
    columns |= {"i3_a": [1.0, -2.0, 0.0], "tau1_nm": [5.0, 6.0, 7.0], "i3_std_a": [0.1, 0.1, 0.1]}
    table = read_csv(write(tmp_path / "t.csv", columns), conversion())
    assert table.motor_torque_nm[:, 2] == pytest.approx([1.5, -3.0, 0.0])
    assert table.tau_nm[:, 2] == pytest.approx([-120.0, 240.0, 0.0])
    assert table.tau_nm[:, 0].tolist() == [5.0, 6.0, 7.0]
    assert table.tau_std_nm[:, 2] == pytest.approx([12.0] * 3)


def test_own_columns(tmp_path):
    table = read_csv(write(tmp_path / "t.csv", rest_rows(x_k2_m=[0.5, 1, 2], x_note=["a", "", "c"])), None)
    assert table.extra["x_k2_m"].tolist() == [0.5, 1.0, 2.0]
    assert table.extra["x_note"].tolist() == ["a", "", "c"]


def test_take_and_concatenate(tmp_path):
    one = read_csv(write(tmp_path / "one.csv", rest_rows(x_a=[1, 2, 3])), None)
    two = read_csv(write(tmp_path / "two.csv", rest_rows()), None)
    both = concatenate([one, two])
    assert len(both) == 6
    assert both.file[3] == str(tmp_path / "two.csv")
    assert np.isnan(both.extra["x_a"][3:]).all()
    part = both.take(both.pose == 2)
    assert part.run.tolist() == ["one", "two"]
    assert part.line.tolist() == [3, 3]
    assert both.take(np.array([5, 0])).pose.tolist() == [3, 1]
    with pytest.raises(InputError):
        concatenate([])


def same(one: Table, two: Table) -> bool:
    names = ["q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm", "tau_std_nm", "time_s", "direction", "q2nd_rad", "pose"]
    return all(np.array_equal(getattr(one, n), getattr(two, n), equal_nan=True) for n in names)


def test_written_table_reads_back_exactly(tmp_path):
    columns = rest_rows(pose=[1, "", ""], time_s=["", 0.1, 0.2], temp1_c=[20, 21, 22], q2nd2_rad=[0.1, 0.2, 0.3])
    columns |= {name: ["", 0.0, 1 / 3] for name in (*QD, *QDD)} | {"load": ["a", "b, c", '"d"'], "dir3": [1, 0, -1]}
    first = read_csv(write(tmp_path / "t.csv", columns), None)
    write_csv(first, tmp_path / "back.csv")
    second = read_csv(tmp_path / "back.csv", None)
    assert same(first, second)
    assert second.load.tolist() == ["a", "b, c", '"d"']


def test_an_axis_measured_in_some_rows_only_cannot_be_written(tmp_path):
    columns = rest_rows()
    one = read_csv(write(tmp_path / "one.csv", columns), None)
    del columns["tau4_nm"]
    two = read_csv(write(tmp_path / "two.csv", columns), None)
    with pytest.raises(InputError, match="axis 4"):
        write_csv(concatenate([one, two]), tmp_path / "out.csv")


def test_unwritable_path(tmp_path):
    table = read_csv(write(tmp_path / "t.csv", rest_rows()), None)
    with pytest.raises(InputError, match="cannot be written"):
        write_csv(table, tmp_path / "missing" / "t.csv")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_text_gives_a_table_or_a_typed_error(tmp_path, data):
    path = write(tmp_path / "t.csv", rest_rows(load=["a", "b", "c"], dir1=[0, 1, -1]))
    text = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        start = data.draw(st.integers(0, len(text)))
        stop = data.draw(st.integers(start, min(len(text), start + 4)))
        text[start:stop] = data.draw(st.binary(max_size=4))
    path.write_bytes(bytes(text))
    try:
        table = read_csv(path, None)
    except InputError:
        return
    assert np.isfinite(table.q_rad).all()


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "rows", "moving"),
    [("kr300/run_A.csv", 800, True), ("tx40/run_1_first.csv", 553, True), ("ur10/run_1_first.csv", 1078, True)],
)
def test_measured_runs_load(measured_data, name, rows, moving):
    table = read_csv(measured_data / name, None)
    assert len(table) == rows
    assert table.moving.all() == moving
    assert np.isfinite(table.tau_nm).all()


@pytest.mark.parametrize("axes", [2, 4, 7, 8])
def test_the_number_of_axes_is_that_of_the_columns(tmp_path, axes):
    names = [pattern.format(i) for pattern in ("q{}_rad", "tau{}_nm", "dir{}", "temp{}_c") for i in range(1, axes + 1)]
    columns = {"pose": [1, 2], **{name: [1, -1] for name in names}}
    table = read_csv(write(tmp_path / "t.csv", columns), None)
    assert table.axes == axes
    assert table.tau_nm.shape == table.direction.shape == table.temperature_c.shape == (2, axes)
    write_csv(table, tmp_path / "again.csv")
    assert set(names) < set((tmp_path / "again.csv").read_text().splitlines()[0].split(","))


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (["load"], "columns of 0 axes; 1 to 8"),
        (["x_own"], "columns of 0 axes"),
        (["q1_rad", "q2_rad", "tau3_nm"], "'q3_rad' is missing"),
        ([*(f"q{i}_rad" for i in range(1, 10)), "tau1_nm"], "unknown column 'q9_rad'"),
    ],
)
def test_a_table_of_too_few_or_too_many_axes_is_refused(tmp_path, names, says):
    with pytest.raises(InputError, match=says):
        read_csv(write(tmp_path / "t.csv", {"pose": [1], **{name: [0.5] for name in names}}), None)


def test_tables_of_different_arms_are_not_put_together(tmp_path):
    four = {"pose": [1], **{name: [0.5] for name in (*Q[:4], *TAU[:4])}}
    tables = [read_csv(write(tmp_path / "a.csv", rest_rows()), None), read_csv(write(tmp_path / "b.csv", four), None)]
    with pytest.raises(InputError, match=r"different numbers of axes \(.*a.csv 6, .*b.csv 4\)"):
        concatenate(tables)


@pytest.mark.parametrize("label", ['=HYPERLINK("http://x")', "+1", "-tool", "@x", "'=quoted", "'plain", "''+twice"])
def test_a_label_is_no_formula_in_a_spreadsheet_and_comes_back(tmp_path, label):
    text = ",".join(["load", "run", "pose", "x_note", *(f"q{i}_rad" for i in range(1, 7)), "tau2_nm"])
    quoted = '"' + label.replace('"', '""') + '"'
    first = tmp_path / "first.csv"
    first.write_text(f"{text}\n{quoted},{quoted},1,{quoted},0,0,0,0,0,0,-1.5\n")
    table = read_csv(first, None)
    write_csv(table, tmp_path / "second.csv")
    with (tmp_path / "second.csv").open(newline="") as stream:
        header, row = csv.reader(stream)
    cells = dict(zip(header, row, strict=True))
    assert not [name for name in ("load", "run", "x_note") if cells[name][0] in "=+-@"]
    assert float(cells["tau2_nm"]) == -1.5
    back = read_csv(tmp_path / "second.csv", None)
    assert (back.load[0], back.run[0], back.extra["x_note"][0]) == (
        table.load[0],
        table.run[0],
        table.extra["x_note"][0],
    )
