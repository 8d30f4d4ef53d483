"""TOML from strangers: `tomllib` with bounded depth.

The standard library's parser takes time and memory with the square of the number of parts of a dotted key, recurses
once per open bracket, and lets the interpreter's own errors through; no honest file comes near these bounds.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any, Final

#: Largest number of nested brackets and of parts of a dotted key.
MAX_DEPTH: Final = 64

_LONG_KEY: Final = re.compile(r"(?<![\w\"'.-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){%d}" % MAX_DEPTH)
_DEEP: Final = re.compile(r"[\[{](?:[\s\[{]*+[\w\"'.= \t-]*+[\[{]){%d}" % MAX_DEPTH)


def parse_toml(text: str) -> dict[str, Any]:
    """Tables and values of a TOML text.

    Raises
    ------
    tomllib.TOMLDecodeError
        Not TOML, deeper than `MAX_DEPTH`, or a number that cannot be held.
    """
    if _LONG_KEY.search(text) or _DEEP.search(text):
        raise tomllib.TOMLDecodeError(f"keys or brackets are nested deeper than {MAX_DEPTH}")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except (ValueError, OverflowError, RecursionError) as error:
        raise tomllib.TOMLDecodeError(str(error) or type(error).__name__) from error
