"""Sentences of pages and docstrings with more than 30 words; part of `make lint`.

python -m benchmarks.language

Words are checked by codespell: its own dictionary, and the project's in `benchmarks/words.txt`.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
LONGEST: Final = 30
"""Words."""
ALLOWED: Final = 57
"""Longer sentences in the repository; this number only falls."""
_CODE: Final = re.compile(r"```.*?```|`[^`]*`|\]\([^)]*\)|<[A-Za-z/!][^>\n]*>|\$[^$\n]*\$", re.DOTALL)
#: A blank line, a bullet, a heading, a rule, the head of a parameter: where a block of text ends.
_BLOCK: Final = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*|#>]|\d+\.)\s?)|\n-{3,}\n|\n(?=\s*[\w, *`]+ : )")


def long_sentences(text: str) -> list[str]:
    """Return the sentences of a text with more than 30 words; tables, code and formulas are left out."""
    blocks = (block for block in _BLOCK.split(_CODE.sub(" x ", text)) if not block.lstrip().startswith("|"))
    sentences = (sentence for block in blocks for sentence in re.split(r"(?<=[.!?])\s+", block))
    return [each for each in sentences if len(re.findall(r"[A-Za-z][\w'-]*", each)) > LONGEST]


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the text of a page, or each docstring of a Python file, with its first line."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield 1, source
        return
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield node.lineno, text
            case _:
                pass


def main(root: Path = ROOT, allowed: int = ALLOWED) -> int:
    """Print every long sentence of the repository; return 1 where there are more than allowed."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py", "*.md", ":!CHANGELOG.md"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.split("\n")
    paths = [root / name for name in listed if name and (root / name).is_file()]
    found = [
        f"{path.relative_to(root)}:{line}: {' '.join(sentence.split())}"
        for path in paths
        for line, text in texts(path)
        for sentence in long_sentences(text)
    ]
    if len(found) > allowed:
        print(*found, f"{len(found)} sentences over {LONGEST} words, {allowed} allowed", sep="\n", file=sys.stderr)
    return int(len(found) > allowed)


if __name__ == "__main__":
    sys.exit(main())
