"""Libraries that are there with an extra of the package, and are named in one sentence where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from gateway.errors import ConfigError


def needed(module: str, what: str, extra: str) -> Any:
    """A module of a library that not every user has.

    Parameters
    ----------
    module : str
    what : str
        What needs it, for the message.
    extra : str
        Of the package, with which it is installed.

    Raises
    ------
    ConfigError
        It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise ConfigError(f'{what} needs {library}: pip install "servo-gateway[{extra}]"') from error
