"""The public Python interface: read measured data, estimate loads, find what the model lacks, read a drive.

Import from here: `from gateway.api import estimate, read`. Nothing in this interface moves an arm or writes to a drive;
the functions of `gateway.jobs` do. What `__all__` lists is public, and what the page of the Python interface lists of
`gateway.jobs`; every other module may change in any version.

Units are SI and part of every name (`_kg _m _rad _nm _s`), joints count from 1. Errors are of `GatewayError` or
`DriveError`: their text says what happened, where, and what to do.
"""

from drives.errors import DriveError
from drives.values import Identity
from gateway.api.analysis import diagnose, estimate, read
from gateway.api.drive import Drive
from gateway.cell.config import Cell, load_cell
from gateway.data.table import Table
from gateway.errors import GatewayError
from gateway.pipeline.inputs import ModelRequest
from gateway.pipeline.known import KnownLoad
from gateway.report.render import render
from gateway.result.result import Result, read_result, to_json

__all__ = [
    "Cell",
    "Drive",
    "DriveError",
    "GatewayError",
    "Identity",
    "KnownLoad",
    "ModelRequest",
    "Result",
    "Table",
    "diagnose",
    "estimate",
    "load_cell",
    "read",
    "read_result",
    "render",
    "to_json",
]
