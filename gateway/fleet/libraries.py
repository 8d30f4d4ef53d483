"""Libraries that only a fleet needs, imported when they are needed, or named in one sentence."""

from __future__ import annotations

import importlib
from typing import Any

from gateway.errors import ConfigError


def library(name: str) -> Any:
    """A module of the extra `fleet`.

    Raises
    ------
    ConfigError
        It is not installed; says how it is.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f'a fleet needs the library {name.partition(".")[0]}: pip install "servo-gateway[fleet]"'
        ) from error
