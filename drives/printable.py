"""Text of unknown origin (names in drives, data sheets, files) made safe for one line of a terminal or a file."""

from __future__ import annotations


def one_line(text: str) -> str:
    """Replace each character that is not printable (control, escape, text direction) by a space, and strip the ends."""
    return without_controls(text).strip()


def without_controls(text: str, keep: str = "") -> str:
    """Replace each character that is neither printable nor in `keep` by a space."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() or char in keep else " " for char in text)
