"""Pieces of a part that do not depend on the clock, several at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

Piece = TypeVar("Piece", bound=Sequence[Any])
Found = TypeVar("Found")


def side_by_side(
    job: Callable[..., Found], pieces: Sequence[Piece], jobs: int | None = None
) -> Iterator[tuple[Piece, Found]]:
    """Do a job for each piece, its arguments, in processes of their own; each with what came of it, as they end.

    Parameters
    ----------
    job : callable
        A function of a module.
    pieces : sequence of sequences
    jobs : int, optional
        So many at a time; as many as the computer has cores if not given.
    """
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(job, *piece): piece for piece in pieces}
        for done in as_completed(waiting):
            yield waiting[done], done.result()
