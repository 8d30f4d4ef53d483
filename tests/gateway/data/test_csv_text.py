"""Columns of text and of numbers, in tables and in paths."""

from __future__ import annotations

import pytest

from gateway.data.csv_text import read_columns, read_path_columns
from gateway.errors import InputError

NEEDED = ("time_s", "x_m", "y_m")


def test_a_column_of_a_path_is_a_number_also_where_its_name_begins_as_an_own_one(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("time_s,x_m,y_m\n0,true,0.5\n1,0.1,0.2\n")
    with pytest.raises(InputError, match=r"path.csv:2: x_m: 'true' is not a finite number"):
        read_path_columns(path, NEEDED)
    path.write_text("# a remark\ntime_s,x_m,y_m,x_note\n0,0.3,0.5,first\n1,0.1,0.2,second\n")
    columns = read_path_columns(path, NEEDED)
    assert columns.values["x_m"].tolist() == [0.3, 0.1]
    assert columns.values["x_note"].tolist() == ["first", "second"]
    assert columns.line.tolist() == [3, 4]


def test_an_own_column_of_a_table_is_text_or_numbers_by_its_first_cell(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("pose,q1_rad,x_lever,x_who\n1,0.1,0.7,ann\n2,0.2,0.9,bob\n")
    columns = read_columns(path)
    assert columns.values["x_lever"].tolist() == [0.7, 0.9]
    assert columns.values["x_who"].tolist() == ["ann", "bob"]
