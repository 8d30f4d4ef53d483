"""Typed errors of the gateway; each carries the exit code of the command line.

GatewayError (1)
+-- ConfigError (3)     cell, robot or profile file: what, where (file:key), what to do
+-- InputError (3)      measured table, recording, result file: file:line
+-- PlanRefused (5)     nothing moved, or motion was stopped, and why
+-- DataUnusable (6)    rank, too few poses, nothing to hold out
+-- FindingFailed (7)   finished, with a failing finding

Bus and drive errors (4) are `drives.errors.DriveError`.
"""


class GatewayError(Exception):
    """Base: one paragraph that says what, where, and what to do."""

    exit_code = 1


class ConfigError(GatewayError, ValueError):
    """A configuration file that cannot be used."""

    exit_code = 3


class InputError(GatewayError, ValueError):
    """A data file that cannot be used."""

    exit_code = 3


class PlanRefused(GatewayError):  # noqa: N818 - reads as what happened
    """A motion that is not allowed, or that had to be stopped."""

    exit_code = 5


class DataUnusable(GatewayError):  # noqa: N818 - reads as what happened
    """Data that are valid but cannot answer the question."""

    exit_code = 6


class FindingFailed(GatewayError):  # noqa: N818 - reads as what happened
    """The command finished; a finding of severity `fail` stands."""

    exit_code = 7
