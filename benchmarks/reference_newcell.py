"""Reference page on the questions of `cell new`."""

from __future__ import annotations

from gateway.newcell.questions import ALL


def cell_answers_page() -> str:
    """Return the page: key, question and source of each answer."""
    lines = [
        "# Questions of a new cell",
        "",
        "`servo-gateway cell new` asks for values that neither the URDF nor the drives contain. It asks at a terminal,",
        "or takes `--answer KEY=VALUE` or a file with `--answers FILE` (TOML, one key each; file names",
        "are relative to it). A value that was read is not asked; an answer replaces it. The source of a constant is",
        'given as `{ value = 101, source = "data sheet p. 4" }`, at the terminal as `101; data sheet p. 4`.',
        "",
        "| key | answer | how to find out |",
        "|---|---|---|",
    ]
    lines += [f"| `{question.key}` | {question.asks} | {question.how} |" for question in ALL]
    return "\n".join(lines) + "\n"
