"""Libraries of other programs' formats: there with an extra, named where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from gateway.errors import ConfigError


def needed(module: str, what: str) -> Any:
    """A library that one format needs.

    Parameters
    ----------
    module : str
    what : str
        What needs it, for the message.

    Raises
    ------
    ConfigError
        It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise ConfigError(f'{what} needs {library}: pip install "servo-gateway[formats]"') from error
