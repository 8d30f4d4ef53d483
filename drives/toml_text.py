"""Parse untrusted TOML with `tomllib` at bounded cost.

The standard library's parser takes time and memory with the square of the number of parts of a dotted key, recurses
once per open bracket, and lets the interpreter's own errors through; real files are far below these bounds.
"""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any, Final

#: Largest number of parts of a dotted key.
MAX_PARTS: Final = 64

_LONG_KEY: Final = re.compile(rf"(?<![\w\"'.-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){{{MAX_PARTS}}}")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML text to nested dictionaries.

    Raises
    ------
    tomllib.TOMLDecodeError
        Not TOML, a key of more than `MAX_PARTS` parts, or a number that cannot be held.
    """
    if _LONG_KEY.search(text):
        raise tomllib.TOMLDecodeError(f"a key has more than {MAX_PARTS} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except (ValueError, OverflowError, RecursionError) as error:
        raise tomllib.TOMLDecodeError(str(error) or type(error).__name__) from error


def toml_string(text: str) -> str:
    """Return a text as a one-line TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
