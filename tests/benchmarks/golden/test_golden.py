"""The golden tables: twenty of them answer as stored, and an answer that changed is reported."""

from __future__ import annotations

import json

import pytest

from benchmarks.golden.__main__ import STORED
from benchmarks.golden.answers import answer_of, read_answers
from benchmarks.golden.differences import changes
from benchmarks.golden.tables import FILES, names

#: Relative difference below which a load counts as unchanged; other linear algebra kernels make 0.5 % in motion.
SAME = 0.02
TWENTY = [name for name in names() if not name.startswith(FILES)][7::12][:20]


@pytest.mark.slow
@pytest.mark.parametrize("name", TWENTY)
def test_a_table_answers_as_stored(name: str):
    assert changes(read_answers(STORED), {name: answer_of(name)}, SAME) == []


@pytest.mark.parametrize("key", ["exit", "verdict", "effects", "findings"])
def test_another_answer_is_reported(key: str):
    stored = {TWENTY[0]: read_answers(STORED)[TWENTY[0]]}
    other = json.loads(json.dumps(stored))
    other[TWENTY[0]]["diagnose"][key] = "another"
    (line,) = changes(stored, other)
    assert key in line
