"""python-can without the libraries that its reader of MF4 files would load: a second, at the start of every program.

Where asammdf is installed, `import can` loads it and pandas with it, though no MF4 file is read through python-can here
(`gateway/formats` uses asammdf itself). The finder below is asked when python-can comes to that module.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Final

_MODULE: Final = "can.io.mf4"
_LIBRARY: Final = "asammdf"


class WithoutLibrary(Loader):
    """Loads the module as if the library were not installed; the module itself foresees that."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """As the module's own loader."""
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Run the module; afterwards the library can be imported as ever."""
        sys.modules[_LIBRARY] = None  # type: ignore[assignment]  # what makes an import of it fail
        try:
            self._loader.exec_module(module)
        finally:
            del sys.modules[_LIBRARY]


class LeanFinder(MetaPathFinder):
    """Finder of that one module; finds nothing where the library is already loaded."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Spec of the module, to be loaded without the library."""
        if fullname != _MODULE or _LIBRARY in sys.modules:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = WithoutLibrary(spec.loader)
        return spec


def keep_lean() -> None:
    """Have python-can loaded so from now on."""
    if not any(isinstance(finder, LeanFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, LeanFinder())
