"""Entry point of the diagnosis: visits at rest by one strategy, moving runs by the other, one result for both."""

from __future__ import annotations

from gateway.data.table import Table
from gateway.diagnose.moving.diagnosis import diagnose_motion
from gateway.diagnose.options import DiagnoseOptions
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.model.robot import Robot
from gateway.result.result import Result


def diagnose(table: Table, robot: Robot, options: DiagnoseOptions | None = None) -> Result:
    """Find what the model lacks.

    Parameters
    ----------
    table : Table
        Rest visits, or a moving run; where both are present the rest visits are judged.
    robot : Robot
    options : DiagnoseOptions, optional

    Returns
    -------
    Result with verdict, effects, evidence, loads before and after, and what to measure next

    Raises
    ------
    DataUnusable : no torque measured, or no rest visit and no motion
    InputError : a known load that is not in the data
    ConfigError : `inertials` is not understood
    """
    options = options or DiagnoseOptions()
    if table.moving.all():
        return diagnose_motion(table, robot, options)
    rest = RestDiagnosis(robot, options)
    return rest.report(rest.search(table.take(~table.moving)), options.holdout, options.holdout_kind)
