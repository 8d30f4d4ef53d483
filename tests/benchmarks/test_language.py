"""Sentences are counted in pages and docstrings; tables, code and formulas are no sentences."""

from __future__ import annotations

from benchmarks.language import long_sentences, texts

SHORT, LONG = " ".join(["word"] * 30) + ".", " ".join(["word"] * 31) + "."


def test_a_sentence_of_a_page_or_a_docstring_ends_at_a_full_stop(tmp_path):
    assert long_sentences(f"{SHORT} {SHORT}\n\n| {LONG} |\n\n```\n{LONG}\n```\n") == []
    page, code = tmp_path / "page.md", tmp_path / "code.py"
    page.write_text(f"{SHORT} {LONG}")
    code.write_text(f'"""First."""\n\ndef f():\n    """{LONG}"""\n    return "{LONG}"\n')
    assert [long_sentences(text) for _, text in texts(page)] == [[LONG]]
    assert [(line, long_sentences(text)) for line, text in texts(code)] == [(1, []), (4, [LONG])]
