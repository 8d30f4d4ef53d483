"""Two drives are in each other's place."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="axes_swapped",
    words="two axes swapped",
    meaning="two drives are in each other's place",
    mistake=("drives are in each other's place", "swap the node ids of these axes in the cell file, or their cables"),
)
