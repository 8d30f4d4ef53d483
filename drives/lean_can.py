"""python-can without the libraries that its reader of MF4 files would load: a second, at the start of every program.

Where asammdf is installed, `import can` loads it and pandas with it, though no MF4 file is read through python-can here
(`gateway/formats` uses asammdf itself). Afterwards the library can be imported as ever.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import ModuleType
from typing import Final

_MODULE: Final = "can.io.mf4"
_LIBRARY: Final = "asammdf"


class LeanFinder(MetaPathFinder):
    """Finder that hides the library while python-can's module is being loaded; the module itself foresees that."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        """Find nothing; raise `ModuleNotFoundError` for the library until the class of the module exists."""
        if fullname == _LIBRARY and _MODULE in sys.modules and not hasattr(sys.modules[_MODULE], "MF4Reader"):
            raise ModuleNotFoundError(f"{_LIBRARY} is not loaded for {_MODULE}")


def keep_lean() -> None:
    """Have python-can loaded so from now on."""
    if not any(isinstance(finder, LeanFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, LeanFinder())
