"""Words of the old vocabulary are found where they have their private meaning, and ceilings only go down."""

from __future__ import annotations

import pytest

from benchmarks.language import (
    in_text,
    long_sentences,
    lowered,
    over,
    slips_of_python,
)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a load hung on the flange", ["hung"]),
        ("stopped on the way to pose 7", ["way"]),
        ("nobody is told whether it stands still", ["nobody", "told", "stands"]),
        ("the residuals are alike", ["alike"]),
        ("what is set aside is gross", ["aside", "gross"]),
        ("answers by the clock", ["by the clock"]),
        ("'x' is no column of the table", ["is no column"]),
    ],
)
def test_words_with_a_private_meaning_are_found(text, found):
    assert in_text(text) == found


def test_a_python_file_is_read_once_for_each_name_and_everywhere_for_texts():
    source = '"""Who is told."""\ndoubt = 1\ndoubt = 2\n# late\ntext = f"on the way {doubt}"\n'
    assert [(each.line, each.found) for each in slips_of_python("gateway/a.py", source)] == [
        (2, "doubt"),
        (1, "told"),
        (5, "way"),
        (4, "late"),
    ]


def test_word_counts_end_at_a_full_stop():
    short, long = " ".join(["word"] * 30) + ".", " ".join(["word"] * 31) + "."
    assert long_sentences(f"{short} {short}\n\n| {long} |") == []
    assert long_sentences(f"{short} {long}") == [long]


def test_a_count_above_its_ceiling_is_an_error_and_a_ceiling_never_rises():
    counted = {"a": {"word": 3, "long": 0}, "b": {"word": 1, "long": 0}, "c": {"word": 0, "long": 0}}
    ceilings = {"a": {"word": 2, "long": 1}, "c": {"word": 5, "long": 0}}
    assert [message.split(",")[0] for message in over(counted, ceilings)] == ["a: 3 old words", "b: 1 old words"]
    assert lowered(counted, ceilings) == {"a": {"word": 2, "long": 0}}
