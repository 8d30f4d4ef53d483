"""The last fifth of a measured run is seen by no fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.measured import split
from gateway.data.rows import MOVING
from tests.support.rigs.tables import make_table


def test_the_last_fifth_of_the_time_is_held_out():
    time = np.linspace(3.0, 13.0, 101)
    table = make_table(["none"] * 101, np.full(101, MOVING), np.zeros((101, 6)), np.zeros((101, 6)), time=time)
    fitted, held = split(table)
    assert len(fitted.time_s) + len(held.time_s) == 101
    assert fitted.time_s.max() <= 11.0 < held.time_s.min()


def test_where_the_mass_of_the_published_table_is_printed_it_is_said_to_be_no_test():
    """The lever of that table was computed back from the column that the mass comes from."""
    pages = [Path("README.md"), *Path("docs").rglob("*.md")]
    sections = [part for page in pages for part in page.read_text(encoding="utf-8").split("\n## ") if "21.06" in part]
    assert sections
    for part in sections:
        words = " ".join(part.split())
        assert "This does not test accuracy." in words
        assert "was computed back from the table" in words
