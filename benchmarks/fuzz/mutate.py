"""Hypothesis strategies for input from strangers: files that were valid once, and frames of any content."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hypothesis import strategies as st

#: Pieces that have broken parsers before, whatever the format.
TOKENS: tuple[bytes, ...] = (
    b"\x00",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\r",
    b'"',
    b"'''",
    b"[" * 3000,
    b"[[" * 600 + b"]]" * 600,
    b"a." * 3000,
    b"{" * 3000,
    b"9" * 5000,
    b"1e400",
    b"-0.0",
    b"nan",
    b"inf",
    b"1_0",
    b"0x" + b"f" * 40,
    b"9223372036854775808",
    b"1979-13-45T99:99:99Z",
    b"\xed\xa0\x80",
    "\u0663.\u0664".encode(),
    b"true",
    b"<" * 2000,
    b"<a>" * 3000,
    b"&lol;",
    b"<!DOCTYPE x [<!ENTITY lol 'lol'>]>",
    b"<!-- -->",
    b",,,,",
    b"\n" * 50,
    b"#",
    b"=",
)

Edit = tuple[str, int, int, bytes]

_EDITS = st.tuples(
    st.sampled_from(("delete", "repeat", "insert", "replace", "cut", "swap")),
    st.integers(0, 2**20),
    st.one_of(st.integers(0, 8), st.integers(0, 4000)),
    st.one_of(
        st.sampled_from(TOKENS), st.binary(max_size=6), st.from_regex(rb"-?[0-9]{1,4}(\.[0-9]{1,3})?", fullmatch=True)
    ),
)


def edited(seeds: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    """A valid file after a few edits (sometimes none), or a short run of any bytes."""
    changed = st.builds(apply_edits, st.sampled_from(list(seeds)), st.lists(_EDITS, max_size=5))
    return st.one_of(changed, changed, changed, st.binary(max_size=200))


def apply_edits(seed: bytes, edits: Sequence[Edit]) -> bytes:
    """A file after edits: what, where, how long, and the piece that is put in."""
    data = seed
    for kind, position, length, piece in edits:
        start = position % (len(data) + 1)
        stop = min(start + length, len(data))
        if kind == "delete":
            data = data[:start] + data[stop:]
        elif kind == "repeat":
            data = data[:stop] + data[start:stop] + data[stop:]
        elif kind == "insert":
            data = data[:start] + piece + data[start:]
        elif kind == "replace":
            data = data[:start] + piece + data[start + len(piece) :]
        elif kind == "cut":
            data = data[: max(start, 1)]
        else:
            data = data[:start] + data[start:stop][::-1] + data[stop:]
    return data


#: Values that are well formed and that no reader expects at that place.
VALUES: tuple[bytes, ...] = (
    b"0",
    b"-1",
    b"1e-300",
    b"1e9",
    b"1e300",
    b"-1e308",
    b"1e400",
    b"9" * 40,
    b"9" * 400,
    b"NaN",
    b"nan",
    b"inf",
    b"true",
    b"null",
    b"[]",
    b"{}",
    b"[[1], 2]",
    b'""',
    b'"\\ud800"',
    b'"<&>"',
)
_TOKEN = re.compile(rb'"[^"\n]*"|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|true|false|null')

_LIST = re.compile(rb"\[[^\[\]{}]*\]|\{[^\[\]{}]*\}")


def revalued(seeds: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    """A valid JSON, TOML or CSV file with a few of its values exchanged: what still reads, and means something odd."""
    number = st.from_regex(rb"-?[0-9]{1,4}(\.[0-9]{1,3})?", fullmatch=True)
    change = st.tuples(st.integers(0, 2**20), st.one_of(st.sampled_from(VALUES), number))
    return st.builds(_revalue, st.sampled_from(list(seeds)), st.lists(change, min_size=1, max_size=3))


def _revalue(seed: bytes, changes: Sequence[tuple[int, bytes]]) -> bytes:
    data = seed
    for place, value in changes:
        found = list((_LIST if place % 4 == 0 else _TOKEN).finditer(data))
        if found:
            token = found[place // 4 % len(found)]
            data = data[: token.start()] + value + data[token.end() :]
    return data


def damaged(seeds: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    """As `edited` or as `revalued`."""
    return st.one_of(edited(seeds), revalued(seeds))


def frames(ids: Sequence[int], max_frames: int = 6) -> st.SearchStrategy[list[tuple[int, bytes]]]:
    """A few CAN frames (id, 0 to 8 bytes)."""
    return st.lists(st.tuples(st.sampled_from(list(ids)), st.binary(max_size=8)), max_size=max_frames)
