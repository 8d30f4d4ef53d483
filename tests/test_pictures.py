"""Pictures of the documentation show the pages as they are drawn now."""

from __future__ import annotations

import pytest

from benchmarks.pictures import PICTURES, SHOTS, checksum, source_of


@pytest.mark.parametrize("name", sorted({*SHOTS, *(file.stem for file in PICTURES.glob("*.png"))}))
def test_a_picture_has_the_checksum_of_its_page(name: str) -> None:
    assert name in SHOTS, "add its row to benchmarks/pictures.py"
    assert source_of((PICTURES / f"{name}.png").read_bytes()) == checksum(name), "python -m benchmarks.pictures"
