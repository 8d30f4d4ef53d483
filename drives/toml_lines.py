"""Return the line of each key and element of a TOML text, which `tomllib` does not provide.

The text has been parsed already: what is read here is known to be TOML, so that tokens and brackets are enough.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Final

#: Keys and indices from the top of the file.
KeyPath = tuple[str | int, ...]

_TOKEN: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*|\n|[\[\]{}=,.]|[^\s\[\]{}=,."\'#]+',
    re.DOTALL,
)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line (from 1) of every table, key and element of a TOML text; the first one of a reopened table."""
    scan = _Scan()
    line = 1
    for match in _TOKEN.finditer(text.replace("\r\n", "\n") + "\n"):
        token = match.group()
        if not token.startswith("#"):
            scan.take(token, line)
        line += token.count("\n")
    return scan.lines


@dataclass(slots=True)
class _Open:
    """Table or array that is being read: its path, its present key, and the index of its next element."""

    kind: str
    path: KeyPath
    key: list[str | int] = field(default_factory=list)
    index: int = 0
    in_value: bool = False

    @property
    def here(self) -> KeyPath:
        """Return the path of the next value."""
        return (*self.path, *((self.index,) if self.kind == "array" else self.key))


class _Scan:
    """Scanner state after the tokens read so far."""

    def __init__(self) -> None:
        self.lines: dict[KeyPath, int] = {(): 1}
        self._stack = [_Open("top", ())]
        self._header: list[str] | None = None
        self._counts: dict[KeyPath, int] = {}

    def take(self, token: str, line: int) -> None:
        """Process one token that is not a comment."""
        if self._header is not None:
            if token == "\n":
                self._open(self._header, line)
            else:
                self._header.append(token)
            return
        frame = self._stack[-1]
        if frame.kind == "array" or frame.in_value:
            self._in_value(frame, token, line)
        elif token == "[" and frame.kind == "top" and not frame.key:
            self._header = [token]
        elif token == "=":
            for length in range(1, len(frame.key) + 1):
                self.lines.setdefault((*frame.path, *frame.key[:length]), line)
            frame.in_value = True
        elif token == "}":
            self._stack.pop()
        elif token not in "\n,.":
            frame.key += _key_parts(token)

    def _in_value(self, frame: _Open, token: str, line: int) -> None:
        if frame.kind == "array" and token not in ("]", ",", "\n"):
            self.lines.setdefault(frame.here, line)
        if token == "{":
            self._stack.append(_Open("table", frame.here))
        elif token == "[":
            self._stack.append(_Open("array", frame.here))
        elif token == "]" or (token == "}" and frame.kind == "table"):
            self._stack.pop()
        elif token == "," and frame.kind == "array":
            frame.index += 1
        elif token == ("\n" if frame.kind == "top" else ","):
            frame.key, frame.in_value = [], False

    def _open(self, header: list[str], line: int) -> None:
        """`[a.b]` and `[[a.b]]`: the table of the next keys."""
        names = [part for each in header if each not in "[]." for part in _key_parts(each)]
        many = header[:2] == ["[", "["]
        path: KeyPath = ()
        for number, name in enumerate(names, start=1):
            path = (*path, name)
            if many and number == len(names):
                self.lines.setdefault(path, line)
                self._counts[path] = self._counts.get(path, -1) + 1
            if path in self._counts:
                path = (*path, self._counts[path])
            self.lines.setdefault(path, line)
        self._header = None
        self._stack = [_Open("top", path)]


def _key_parts(token: str) -> list[str]:
    """Return the parts of a dotted key token."""
    return [token[1:-1]] if token[0] in "\"'" else [token]


def line_of(lines: dict[KeyPath, int], path: KeyPath) -> int:
    """Return the line of a key, or of the nearest parent table that the file contains."""
    return next(lines[path[:length]] for length in range(len(path), -1, -1) if path[:length] in lines)
