"""Mutants: what is changed is one thing, and a test that looks at it notices."""

from __future__ import annotations

import ast
from pathlib import Path

from benchmarks.mutants import Mutant, draw, mirrored, mutated, noticed, places

TEXT = """
def check(a: int | None, b):
    if not a:
        raise ValueError("a" + "b")
    return a < b and a + b
"""


def test_every_place_is_found_once_and_words_are_left_alone():
    found = sorted(place.what for place in places(ast.parse(TEXT)))
    assert found == ["Add to Sub", "And to Or", "Lt to GtE", "not dropped", "raise dropped"]


def test_each_mutant_changes_one_thing():
    plain = ast.unparse(ast.parse(TEXT))
    texts = {mutated(TEXT, number) for number in range(5)}
    assert len(texts) == 5
    for text in texts:
        lines = [pair for pair in zip(plain.splitlines(), text.splitlines(), strict=True) if pair[0] != pair[1]]
        assert len(lines) == 1, lines


def test_mutants_are_drawn_by_the_seed(tmp_path):
    (tmp_path / "drives").mkdir()
    (tmp_path / "drives" / "a.py").write_text(TEXT * 4)
    first = draw(3, 1, ["drives"], tmp_path)
    assert first == draw(3, 1, ["drives"], tmp_path)
    assert len(first) == 3
    assert first != draw(3, 2, ["drives"], tmp_path)


def test_mirrored_tests_begin_with_the_file_of_the_module():
    assert mirrored("drives/epoch.py")[0] == "tests/drives/test_epoch.py"
    assert mirrored("gateway/motion/watch.py") == ["tests/gateway/motion/test_watch.py", "tests/gateway/motion"]


def test_a_test_that_looks_notices_and_one_that_does_not_look_does_not(tmp_path):
    for name, text in {
        "drives/__init__.py": "",
        "drives/a.py": "def larger(a, b):\n    return a if a > b else b\n",
        "tests/drives/test_a.py": "from drives.a import larger\n\ndef test_larger():\n    assert larger(1, 2) == 2\n",
        "pyproject.toml": '[tool.pytest.ini_options]\npythonpath = ["."]\n',
    }.items():
        Path(tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    mutant = Mutant("drives/a.py", 2, 0, "Gt to LtE")
    assert noticed(mutant, tmp_path)
    assert "a > b" in (tmp_path / "drives/a.py").read_text()
    (tmp_path / "tests/drives/test_a.py").write_text("def test_nothing():\n    pass\n")
    assert not noticed(mutant, tmp_path)
