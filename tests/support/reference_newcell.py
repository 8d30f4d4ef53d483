"""Page of the reference about a new cell: its questions."""

from __future__ import annotations

from gateway.newcell.questions import ALL


def cell_answers_page() -> str:
    """What `cell new` asks, and how to find out."""
    lines = [
        "# Questions of a new cell",
        "",
        "What neither URDF nor drives say, as `servo-gateway cell new` asks it at a terminal, takes it with",
        "`--answer KEY=VALUE`, or reads it from a file with `--answers FILE` (TOML, one key each; names of files start",
        "beside it). What is read is not asked, and an answer goes before it. Where a constant comes from is said by",
        '`{ value = 101, source = "data sheet p. 4" }`, at the terminal by `101; data sheet p. 4`.',
        "",
        "| key | answer | how to find out |",
        "|---|---|---|",
    ]
    lines += [f"| `{question.key}` | {question.asks} | {question.how} |" for question in ALL]
    return "\n".join(lines) + "\n"
