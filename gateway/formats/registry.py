"""The open formats by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from gateway.formats.mcap_file import to_mcap
from gateway.formats.parquet_file import to_parquet
from gateway.formats.samples import Samples, read_samples

#: format -> content of its file, from every sample.
FORMATS: Final[Mapping[str, Callable[[Samples], bytes]]] = {"mcap": to_mcap, "parquet": to_parquet}


def written(path: Path, fmt: str, arm_name: str | None, label: str | None) -> tuple[bytes, int]:
    """Content of a recording's file in an open format, and how many samples it holds.

    Parameters
    ----------
    path : Path
        Of the recording.
    fmt : str
        A key of `FORMATS`.
    arm_name, label : str or None
        Only this arm; only this load.

    Raises
    ------
    InputError
        The recording cannot be used.
    ConfigError
        The library of the format is not installed.
    """
    samples = read_samples(path, arm_name, label)
    return FORMATS[fmt](samples), len(samples)
