"""Count words of the old private vocabulary and long sentences by package; draw docstrings and messages at random.

python -m benchmarks.language [--list PACKAGE] [--write] [--sample SEED] [--no-spelling]
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import random
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmarks.vocabulary import EXCEPTIONS, FILES, KEYS, NOT_SPELLED, PARTS, PHRASES, SPELLED, SPELLED_WRONG, WHOLE

ROOT: Final = Path(__file__).resolve().parents[1]
CEILINGS: Final = Path(__file__).with_name("language_ceilings.json")
CODE: Final = ("gateway", "drives", "sim", "benchmarks", "tests")
PAGES: Final = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "examples", "docs")
LONGEST_SENTENCE: Final = 30
"""Words."""
SAMPLES: Final = 40

_PHRASE: Final = re.compile("|".join(rf"\b(?:{pattern})\b" for pattern in PHRASES), re.IGNORECASE)
_PART: Final = frozenset(word for words in PARTS for word in words.split())
_WHOLE: Final = frozenset(word for words in WHOLE for word in words.split())
_FILE: Final = frozenset(word for words in FILES for word in words.split())
_SPLIT: Final = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_CODE_OF_PAGE: Final = re.compile(r"```.*?```|`[^`]*`|\]\([^)]*\)|<[A-Za-z/!][^>\n]*>|\$[^$\n]*\$", re.DOTALL)
_MARKUP: Final = re.compile(r"\{%.*?%\}|\{#.*?#\}|\{\{.*?\}\}|<(script|style)\b.*?</\1>|<[^>]+>", re.DOTALL)
#: A blank line, a bullet, a heading, a rule, the head of a parameter: where a block of text ends.
_BLOCK: Final = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*|#>]|\d+\.)\s?)|\n-{3,}\n|\n(?=\s*[\w, *`]+ : )")
_KEY: Final = re.compile(r"[\w.-]+")


@dataclass(frozen=True, slots=True)
class Slip:
    """A word or sentence that the rules exclude: where it is, its kind ("word", "long") and the text around it."""

    path: str
    line: int
    kind: str
    found: str
    around: str


@dataclass(frozen=True, slots=True)
class Texts:
    """What a reader sees of a file: identifiers that it defines and its texts, each with its line."""

    identifiers: tuple[tuple[str, int], ...]
    docstrings: tuple[tuple[str, int], ...]
    strings: tuple[tuple[str, int], ...]
    comments: tuple[tuple[str, int], ...]


def package(path: str) -> str:
    """Return the package that a file is counted under: `gateway.commands`, `drives`, `docs`, `pages`."""
    parts = path.split("/")
    if parts[0] in ("gateway", "tests") and len(parts) > 2:
        return f"{parts[0]}.{parts[1]}"
    return parts[0] if len(parts) > 1 else "gateway" if path.endswith(".py") else "pages"


def parts_of(identifier: str) -> list[str]:
    """Split an identifier at underscores and capitals."""
    return [part.lower() for part in _SPLIT.findall(identifier)]


def in_identifier(identifier: str) -> list[str]:
    """Return the parts of an identifier that are of the old vocabulary."""
    name = identifier.strip("_").lower()
    if name in KEYS:
        return []
    return [name] if name in _WHOLE else [part for part in parts_of(identifier) if part in _PART]


def in_text(text: str) -> list[str]:
    """Return the phrases of a text that are of the old vocabulary."""
    return [] if text in KEYS else [found.group(0).lower() for found in _PHRASE.finditer(text)]


def long_sentences(text: str) -> list[str]:
    """Return the sentences of a text with more than 30 words; tables, code and formulas are left out."""
    blocks = _BLOCK.split(_CODE_OF_PAGE.sub(" x ", text))
    sentences = (
        sentence
        for block in blocks
        if not block.lstrip().startswith("|")
        for sentence in re.split(r"(?<=[.!?])\s+", block)
    )
    return [each for each in sentences if len(re.findall(r"[A-Za-z][\w'-]*", each)) > LONGEST_SENTENCE]


def _defined(tree: ast.AST) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.name, node.lineno
            case ast.arg():
                yield node.arg, node.lineno
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno
            case _:
                pass


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def read_python(source: str) -> Texts:
    """Return identifiers (once per file), docstrings, strings and comments of a Python file."""
    tree = ast.parse(source)
    names: dict[str, int] = {}
    for name, line in _defined(tree):
        names.setdefault(name, line)
    docs = [node.value for node in ast.walk(tree) if _is_docstring(node)]  # type: ignore[attr-defined]
    inside = {id(node) for node in docs}
    strings = [
        (node.value, node.lineno)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside
    ]
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments = [(token.string, token.start[0]) for token in tokens if token.type == tokenize.COMMENT]
    return Texts(
        tuple(names.items()),
        tuple((node.value, node.lineno) for node in docs),
        tuple(strings),
        tuple(comments),
    )


def slips_of_python(path: str, source: str) -> Iterator[Slip]:
    """Yield what the rules exclude in a Python file."""
    stem = path.rsplit("/", 1)[-1].removesuffix(".py")
    for found in [stem] if stem in _FILE else in_identifier(stem):
        yield Slip(path, 1, "word", found, f"file {stem}.py")
    texts = read_python(source)
    for identifier, line in texts.identifiers:
        for found in in_identifier(identifier):
            yield Slip(path, line, "word", found, identifier)
    for text, line in (*texts.docstrings, *texts.strings, *texts.comments):
        for found in in_text(text):
            yield Slip(path, line, "word", found, around(text, found))
    for text, line in texts.docstrings:
        for sentence in long_sentences(text):
            yield Slip(path, line, "long", str(len(sentence.split())), sentence)


def slips_of_page(path: str, source: str) -> Iterator[Slip]:
    """Yield what the rules exclude in a page, a template or a script that a browser shows."""
    text = source if path.endswith(".md") else _MARKUP.sub(lambda found: "\n" * found.group(0).count("\n"), source)
    if path.endswith(".md"):
        text = _CODE_OF_PAGE.sub(lambda found: " x " + "\n" * found.group(0).count("\n"), text)
    for number, line in enumerate(text.splitlines(), 1):
        for found in in_text(line):
            yield Slip(path, number, "word", found, around(line, found))
    if path.endswith(".md"):
        for sentence in long_sentences(text):
            line = text[: text.find(sentence)].count("\n") + 1
            yield Slip(path, line, "long", str(len(sentence.split())), sentence)


def around(text: str, found: str) -> str:
    """Return the words around a finding, on one line."""
    at = text.lower().find(found)
    return " ".join(text[max(0, at - 40) : at + len(found) + 40].split())


def files(root: Path = ROOT) -> list[str]:
    """Return the paths of code, pages and templates that are in the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", *CODE, *PAGES],
        cwd=root, capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    read = (".py", ".md", ".j2", ".js")
    return sorted({each for each in listed if each.endswith(read) and (root / each).is_file()})


def slips(root: Path = ROOT) -> list[Slip]:
    """Return everything that the rules exclude, without the exceptions."""
    found: list[Slip] = []
    for path in files(root):
        source = (root / path).read_text(encoding="utf-8")
        found += slips_of_python(path, source) if path.endswith(".py") else slips_of_page(path, source)
    return [each for each in found if not {(each.path, each.found), (each.path, "*")} & EXCEPTIONS.keys()]


def counts(found: Iterable[Slip]) -> dict[str, dict[str, int]]:
    """Return the number of words and of long sentences by package."""
    table = Counter((package(each.path), each.kind) for each in found)
    packages = sorted({name for name, _ in table} | {package(path) for path in files()})
    return {name: {kind: table[name, kind] for kind in ("word", "long")} for name in packages}


def over(counted: Mapping[str, Mapping[str, int]], ceilings: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return a message for each package whose count is above its ceiling; a package without one is to be clean."""
    return [
        f"{name}: {number} {'old words' if kind == 'word' else f'sentences over {LONGEST_SENTENCE} words'}, "
        f"{ceilings.get(name, {}).get(kind, 0)} allowed; list them with --list {name}"
        for name, kinds in counted.items()
        for kind, number in kinds.items()
        if number > ceilings.get(name, {}).get(kind, 0)
    ]


def lowered(
    counted: Mapping[str, Mapping[str, int]], ceilings: Mapping[str, Mapping[str, int]]
) -> dict[str, dict[str, int]]:
    """Return the ceilings of today: none rises, and a package that is clean has none."""
    least = {
        name: {kind: min(number, ceilings[name].get(kind, 0)) for kind, number in kinds.items()}
        for name, kinds in counted.items()
        if name in ceilings
    }
    return {name: kinds for name, kinds in least.items() if any(kinds.values())}


def spelling() -> int:
    """Run codespell over the repository; its exit code."""
    command = [sys.executable, "-m", "codespell_lib", *(each for each in (*CODE, *PAGES) if (ROOT / each).exists())]
    options = [f"--skip={','.join(NOT_SPELLED)}", f"--ignore-words-list={','.join((*SPELLED, *SPELLED_WRONG))}"]
    return subprocess.run([*command, *options], cwd=ROOT, check=False).returncode


def _joined(node: ast.AST) -> str | None:
    """Return the text of a string expression, with each value in braces as it is written; None for other nodes."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(_joined(each) or ast.unparse(each) for each in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            texts = [_joined(left), _joined(right)]
            return None if texts == [None, None] else "".join(text or "{...}" for text in texts)
        case _:
            return None


def _messages(node: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield each message (more than four words) whole, with its line: the parts of an f-string or of a sum are one."""
    if _is_docstring(node):
        return
    text = _joined(node)
    if text is None:
        for child in ast.iter_child_nodes(node):
            yield from _messages(child)
    elif len(_KEY.findall(text)) > 4:
        yield text, getattr(node, "lineno", 0)


def sample(seed: int) -> tuple[list[str], list[str]]:
    """Draw docstrings and whole messages of `gateway`, `drives` and `sim` at random."""
    docstrings: list[str] = []
    messages: list[str] = []
    for path in files():
        if not path.endswith(".py") or path.split("/")[0] not in CODE[:3]:
            continue
        source = (ROOT / path).read_text(encoding="utf-8")
        docstrings += [f"{path}:{line}: {text}" for text, line in read_python(source).docstrings]
        messages += [f"{path}:{line}: {text}" for text, line in _messages(ast.parse(source))]
    draw = random.Random(seed)
    return draw.sample(docstrings, SAMPLES), draw.sample(messages, SAMPLES)


def main(arguments: list[str]) -> int:
    """Print the counts by package; return 1 where a count is above its ceiling or a word is misspelt."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", metavar="PACKAGE", help="print each finding of this package")
    parser.add_argument("--write", action="store_true", help="lower the ceilings to the counts of today")
    parser.add_argument("--sample", metavar="SEED", type=int, help="print docstrings and messages drawn at random")
    parser.add_argument("--no-spelling", action="store_true", help="without codespell")
    options = parser.parse_args(arguments)
    if options.sample is not None:
        for title, texts in zip(("docstrings", "messages"), sample(options.sample), strict=True):
            print(f"{SAMPLES} {title}, seed {options.sample}", *texts, sep="\n\n", end="\n\n")
        return 0
    found = slips()
    if options.list:
        for each in found:
            if package(each.path) == options.list:
                print(f"{each.path}:{each.line}: {each.kind} [{each.found}] {each.around}")
        return 0
    counted = counts(found)
    ceilings = json.loads(CEILINGS.read_text(encoding="utf-8"))
    print(f"{'package':24}{'words':>7}{'ceiling':>9}{'long':>7}{'ceiling':>9}")
    for name, kinds in counted.items():
        most = ceilings.get(name, {})
        print(f"{name:24}{kinds['word']:7}{most.get('word', 0):9}{kinds['long']:7}{most.get('long', 0):9}")
    print(f"{'all':24}{sum(k['word'] for k in counted.values()):7}{'':9}{sum(k['long'] for k in counted.values()):7}")
    if options.write:
        lines = (f"  {json.dumps(name)}: {json.dumps(kinds)}" for name, kinds in lowered(counted, ceilings).items())
        CEILINGS.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        return 0
    messages = over(counted, ceilings)
    print(*messages, sep="\n", file=sys.stderr)
    misspelt = 0 if options.no_spelling else spelling()
    return 1 if messages or misspelt else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
