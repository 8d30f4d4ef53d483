"""Names in results and their formats. No numerical library is imported."""

from __future__ import annotations

from typing import Final

#: Metadata of a field that is left out of a file where it is None or empty: `gateway.result.values.plain_values`.
SILENT: Final = {"silent": True}
#: About the centre of gravity, axes of the last link.
INERTIA_PARTS: Final = tuple(f"inertia_{name}_kg_m2" for name in ("xx", "yy", "zz", "xy", "xz", "yz"))
#: All of them.
INERTIA_WHOLE: Final = "inertia_kg_m2"
#: Kind of the file that `rehearse` writes.
REHEARSAL: Final = "rehearsal"
#: What a load is exported as: the keys of `gateway.result.export.FORMATS`.
EXPORT_FORMATS: Final = ("urdf", "json", "abb", "kuka", "ur", "fanuc", "yaskawa", "opc40010", "ros")
#: The load certificate, which a refused load has too: `gateway.result.dcc`.
CERTIFICATE_FORMAT: Final = "dcc"
#: What a recording is exported as: its measured table, or every sample by `gateway.formats`.
TABLE_FORMAT: Final = "csv"
RECORDING_FORMATS: Final = (TABLE_FORMAT, "mcap", "parquet", "mf4", "blf", "h5")
