"""Parquet: one row per sample, one column per quantity and axis; units as field metadata, cell and profiles as file
metadata.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from gateway.data.extras import needed
from gateway.formats.samples import ArmSamples, Measurand, Samples


def to_parquet(samples: Samples) -> bytes:
    """Return the content of a Parquet file.

    Missing values are null; a recorded NaN is NaN. The rows of all arms follow one another, with the column `arm`.
    The columns of axes that an arm lacks are null.

    Raises
    ------
    ConfigError
        pyarrow is not installed.
    """
    pa: Any = needed("pyarrow", "Parquet", "formats")
    parquet: Any = needed("pyarrow.parquet", "Parquet", "formats")
    tables = [_table(pa, arm) for arm in samples.arms]
    complete = (
        pa.concat_tables(tables, promote_options="default") if tables else pa.table({"arm": pa.array([], pa.string())})
    )
    about = dict(samples.about)
    for arm in samples.arms:
        about |= {f"arms/{arm.name}/{name}": text for name, text in arm.about.items()}
    sink = io.BytesIO()
    parquet.write_table(complete.replace_schema_metadata(about), sink, compression="zstd")
    return sink.getvalue()


def _table(pa: Any, arm: ArmSamples) -> Any:
    fields, columns = [pa.field("arm", pa.string())], [pa.array([arm.name] * len(arm), pa.string())]
    for measurand in arm.measurands.values():
        about = _about(measurand)
        for name, values, present in measurand.columns():
            column = _column(pa, values, present)
            fields.append(pa.field(name, column.type, metadata=about))
            columns.append(column)
    return pa.table(columns, schema=pa.schema(fields))


def _about(measurand: Measurand) -> dict[str, str]:
    reported = {"unit": measurand.unit, "remark": measurand.remark}
    return {name: text for name, text in reported.items() if text}


def _column(pa: Any, values: np.ndarray, present: np.ndarray) -> Any:
    kind = pa.string() if values.dtype.kind == "O" else pa.from_numpy_dtype(values.dtype)
    return pa.array(values, kind, mask=None if present.all() else ~present, from_pandas=False)
