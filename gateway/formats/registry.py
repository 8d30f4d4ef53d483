"""Registry of the open formats, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from gateway.errors import InputError
from gateway.formats.blf_file import blf_of
from gateway.formats.mcap_file import to_mcap
from gateway.formats.mf4_file import to_mf4
from gateway.formats.parquet_file import to_parquet
from gateway.formats.passed_on import copy_to_pass_on
from gateway.formats.samples import Samples, read_samples

#: format -> content of its file, from every sample.
FORMATS: Final[Mapping[str, Callable[[Samples], bytes]]] = {"mcap": to_mcap, "parquet": to_parquet, "mf4": to_mf4}
#: The format that holds frames.
FRAMES: Final = "blf"
#: Formats of a complete run, from the recording's file: content, and number of what it holds.
COMPLETE: Final[Mapping[str, Callable[[Path], tuple[bytes, int]]]] = {FRAMES: blf_of, "h5": copy_to_pass_on}


def exported(path: Path, fmt: str, arm_name: str | None, label: str | None) -> tuple[bytes, int]:
    """Return the content of a file in an open format, and the number of its samples or frames.

    Parameters
    ----------
    path : Path
        Of the recording.
    fmt : str
        A key of `FORMATS` or `COMPLETE`.
    arm_name, label : str or None
        Only this arm; only this load.

    Raises
    ------
    InputError
        The recording cannot be used, or holds no such part.
    ConfigError
        The library of the format is not installed.
    """
    if fmt in COMPLETE:
        if arm_name or label:
            raise InputError(f"{path}: --format {fmt} is of the complete run: omit --arm and --load")
        return COMPLETE[fmt](path)
    samples = read_samples(path, arm_name, label)
    return FORMATS[fmt](samples), len(samples)
