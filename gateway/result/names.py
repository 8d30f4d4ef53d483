"""What a result calls the moments of a load's inertia, in the order in which it has them."""

from __future__ import annotations

from typing import Final

#: About the centre of gravity, axes of the last link.
INERTIA_PARTS: Final = tuple(f"inertia_{name}_kg_m2" for name in ("xx", "yy", "zz", "xy", "xz", "yz"))
#: All of them.
INERTIA_WHOLE: Final = "inertia_kg_m2"
