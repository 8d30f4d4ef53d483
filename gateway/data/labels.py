"""Labels of loads on the flange, as used in recordings, tables and on the command line."""

from __future__ import annotations

from typing import Final

#: Label of the unloaded arm.
BARE_LABEL: Final = "none"
#: Longest label.
LONGEST: Final = 200
#: Words that people write for it; as the name of a load they would turn the unloaded arm into an unknown load.
_BARE_IN_OTHER_WORDS: Final = frozenset(
    [
        "none",
        "bare",
        "empty",
        "nothing",
        "unloaded",
        "null",
        "nil",
        "no-load",
        "noload",
        "without",
        "no_load",
        "zero",
        "0",
        "-",
    ]
)


def label_refused(label: str) -> str:
    """Return why a label is invalid and what to write; empty if it is valid."""
    if not label.strip() or not label.isprintable() or len(label) > LONGEST:
        return f"is not a label: write up to {LONGEST} printable characters, {BARE_LABEL} for the unloaded arm"
    if label != label.strip():
        return f"begins or ends with a space: write '{label.strip()}'"
    if label != BARE_LABEL and label.lower().replace(" ", "-") in _BARE_IN_OTHER_WORDS:
        return f"denotes the unloaded arm: write {BARE_LABEL}, or another name for a load"
    return ""
