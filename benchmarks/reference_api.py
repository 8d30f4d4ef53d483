"""Page of the reference on the public Python interface, written from its docstrings."""

from __future__ import annotations

import inspect
import textwrap
from typing import Any

from gateway import api

#: Values whose attributes are documented on a page of their own.
EXPLAINED_ELSEWHERE = {
    "Cell": "[cell file](cell-file.md): the keys are the attributes",
    "Result": "[result file](result.md): the keys are the attributes",
    "Table": "[measured table](measured-table.md): the columns",
}
STABILITY = """\
## What is stable

The public interface consists of the names on this page with their arguments, the commands and their exit codes.
The keys of the files are public too ([result](result.md), [recording](recording.md),
[measured table](measured-table.md), [cell](cell-file.md)). Everything else may change in any version, also names
without a leading underscore.

- Versions are MAJOR.MINOR.PATCH. Before 1.0 a minor version may remove public names, after a deprecation.
- A name is deprecated for one minor version before it is removed. It works, warns (`DeprecationWarning` in Python, a
  line on stderr from a command) and names its successor. The change log lists it.
- Names, arguments with a default, keys and columns may be added at any time: a program that reads JSON must ignore
  unknown keys.
- Numbers are not frozen: a better estimator changes them, and [measured](../measured.md) states by how much.
- Files of an older version are read; the schema number of a file rises when a key changes its meaning.
"""


def api_page() -> str:
    """Return the page: every public name with its signature and docstring."""
    lines = ["# Python interface", "", *_paragraphs(inspect.getdoc(api) or "")]
    lines += ["`examples/python/load_and_effect.py` is a whole program: a table in, load, effect and page out.", ""]
    for name in api.__all__:
        found = getattr(api, name)
        lines += [f"## {name}", ""]
        if name in EXPLAINED_ELSEWHERE:
            lines += [*_paragraphs((inspect.getdoc(found) or "").split("\n\n")[0]), EXPLAINED_ELSEWHERE[name] + ".", ""]
            continue
        lines += _documented(name, found)
        for method, value in vars(found).items() if name == "Drive" else ():
            if not method.startswith("_"):
                lines += _documented(f"Drive.{method}", value)
    return "\n".join([*lines, STABILITY])


def _documented(name: str, found: Any) -> list[str]:
    """Signature and docstring of a function, a method or a class other than an error."""
    text = textwrap.dedent(inspect.getdoc(found) or "")
    if inspect.isclass(found) and issubclass(found, Exception):
        return [*_paragraphs(text), ""]
    signature = inspect.signature(found)
    bare = [
        each.replace(annotation=inspect.Parameter.empty)
        for each in signature.parameters.values()
        if each.name != "self"
    ]
    shown = signature.replace(parameters=bare, return_annotation=inspect.Signature.empty)
    return ["```", f"{name}{shown}", "", text, "```", ""]


def _paragraphs(text: str) -> list[str]:
    return [*text.splitlines(), ""]
