"""Parquet: one row a sample, a column a quantity and axis; units with the fields, cell and profiles with the file."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from gateway.data.extras import needed
from gateway.formats.samples import ArmSamples, Measurand, Samples


def to_parquet(samples: Samples) -> bytes:
    """Content of a Parquet file.

    What is not there is null; a NaN that was recorded stays a NaN. Arms follow one another, told apart by `arm`; one of
    fewer axes leaves the columns of the others null.

    Raises
    ------
    ConfigError
        pyarrow is not installed.
    """
    pa: Any = needed("pyarrow", "Parquet", "formats")
    parquet: Any = needed("pyarrow.parquet", "Parquet", "formats")
    tables = [_table(pa, arm) for arm in samples.arms]
    whole = (
        pa.concat_tables(tables, promote_options="default") if tables else pa.table({"arm": pa.array([], pa.string())})
    )
    about = dict(samples.about)
    for arm in samples.arms:
        about |= {f"arms/{arm.name}/{name}": text for name, text in arm.about.items()}
    sink = io.BytesIO()
    parquet.write_table(whole.replace_schema_metadata(about), sink, compression="zstd")
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
    told = {"unit": measurand.unit, "remark": measurand.remark}
    return {name: text for name, text in told.items() if text}


def _column(pa: Any, values: np.ndarray, present: np.ndarray) -> Any:
    kind = pa.string() if values.dtype.kind == "O" else pa.from_numpy_dtype(values.dtype)
    return pa.array(values, kind, mask=None if present.all() else ~present, from_pandas=False)
