"""Labels of loads: what hangs on the flange, in recordings, tables and on the command line."""

from __future__ import annotations

from typing import Final

#: Nothing hangs on the flange.
BARE_LABEL: Final = "none"
#: Longest label.
LONGEST: Final = 200
#: Words that people write for it; as the name of a load they would make the bare arm an unknown load.
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
    """Why a label cannot be used and what to write; empty if it can."""
    if not label.strip() or not label.isprintable() or len(label) > LONGEST:
        return f"is no label: write up to {LONGEST} printable characters, {BARE_LABEL} for the bare arm"
    if label != label.strip():
        return f"begins or ends with a space: write '{label.strip()}'"
    if label != BARE_LABEL and label.lower().replace(" ", "-") in _BARE_IN_OTHER_WORDS:
        return f"means the bare arm: write {BARE_LABEL}, or a name that a load has"
    return ""
