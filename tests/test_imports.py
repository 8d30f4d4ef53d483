"""Every name that a test or a benchmark imports from the project is there, also where no fast test runs it.

The type checker sees to the packages themselves.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
IMPORT = re.compile(r"(?m)^ *from ((?:benchmarks|drives|gateway|sim|tests)[\w.]*) import (\([^)]*\)|[^\n]*)")


@cache
def source(module: str) -> str | None:
    """Return the text of a module of the project; None if there is none."""
    place = ROOT.joinpath(*module.split("."))
    file = next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None)
    return None if file is None else file.read_text(encoding="utf-8")


def is_bound(name: str, module: str) -> bool:
    """Return whether a module defines, assigns or imports a name, or has a submodule of that name."""
    text = source(module) or ""
    by_itself = rf"^ *(?:(?:async )?def |class |(?:\w+, )*){name}\b"
    imported = rf"^(?: *from [\w.]+)? *import [^\n]*\b{name}\b"
    return source(f"{module}.{name}") is not None or bool(re.search(f"{by_itself}|{imported}", text, re.MULTILINE))


def test_every_imported_name_is_there():
    wrong = []
    for file in (file for folder in ("benchmarks", "tests") for file in (ROOT / folder).rglob("*.py")):
        for module, names in IMPORT.findall(file.read_text(encoding="utf-8")):
            words = [re.sub(r"#.*| as .*|[()\s]", "", word) for word in re.sub(r"#[^\n]*", "", names).split(",")]
            wrong += [f"{file}: {module}.{name}" for name in words if name and not is_bound(name, module)]
    assert not wrong, "\n".join(wrong)
