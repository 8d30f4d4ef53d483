"""Effect: two drives are swapped."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="axes_swapped",
    words="two axes swapped",
    meaning="two drives are swapped",
    mistake=("drives are swapped", "swap the node ids of these axes in the cell file, or their cables"),
)
