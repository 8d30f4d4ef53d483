"""Import of optional libraries; a missing one is reported with the extra of the package that installs it."""

from __future__ import annotations

import importlib
from typing import Any

from gateway.errors import ConfigError


def needed(module: str, what: str, extra: str) -> Any:
    """Import and return an optional module.

    Parameters
    ----------
    module : str
    what : str
        Feature that needs it, for the message.
    extra : str
        Extra of the package that installs it.

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
