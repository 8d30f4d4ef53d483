"""Reference pages generated from the code: measured table, recording, exit codes."""

from __future__ import annotations

import textwrap

from drives.errors import DriveError
from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.data.blackbox.part import FIELDS
from gateway.data.blackbox.ring_buffer import KEPT_S
from gateway.data.blackbox.spool import MOST_BOXES
from gateway.data.csv_text import BLANK_ALLOWED, COLUMNS, PERIOD_COLUMNS, Column
from gateway.data.period import KINDS, LEAST_PER_HARMONIC
from gateway.data.periodic import CUTOFF_HZ
from gateway.data.recording.reader import SCHEMA, STATUSES
from gateway.data.recording.writer import VALUES, WORDS
from gateway.errors import EXIT_CODES, GatewayError


def _paragraph(text: str) -> str:
    return textwrap.fill(text, 118, break_on_hyphens=False)


def table_page() -> str:
    """Return the page on the columns of the measured table."""
    lines = [
        "# Measured table (CSV)",
        "",
        _paragraph(
            "UTF-8, comma, header; one row per visit of a rest pose, or per instant of a moving run. The order of the"
            " columns is free. `servo-gateway export RUN.h5 --format csv` writes one."
        ),
        "",
        "| column | unit | needed | may be empty | meaning |",
        "|---|---|---|---|---|",
        *(
            f"| {_column(each)} | {each.unit} | {each.needed} | {_blank(each)} | {_meaning(each)} |"
            for each in (*COLUMNS, *PERIOD_COLUMNS)
        ),
        "| `x_...` | | no | no | anything else, such as the lever column of `--method coefficient` |",
        "",
        _paragraph(
            f"N is the number of axes, {FEWEST_AXES} to {MOST_AXES}: the highest number in a column name. A table"
            " with another number of axes than the robot is refused. A cell of two arms needs `--arm`: motor torques"
            " and currents are converted with the constants of that arm."
        ),
        "",
        _paragraph(
            "Axes without a column of torque or current were not measured. An axis with the same torque in all samples"
            " is left out with a finding. If that is every axis, or if the torques from both approach directions are"
            " equal (computed torques), the table is refused. Any other column is refused by name."
            " Refused with file and line: a required cell that is empty or not a finite number, an angle that can"
            " only be degrees, and a repeated row with different values. Nothing is ever filled in."
        ),
    ]
    return "\n".join(lines) + "\n"


def _column(column: Column) -> str:
    first, last = (column.name.format(axis) for axis in ("1", "N"))
    return f"`{first}`" if first == last else f"`{first}` .. `{last}`"


def _meaning(column: Column) -> str:
    return column.meaning.format("1")


def _blank(column: Column) -> str:
    return "yes" if column.name.format(1) in BLANK_ALLOWED else "no"


def exit_codes_page() -> str:
    """Return the page of exit codes: the meaning of each, and the errors that end with it."""
    lines = ["# Exit codes", "", "| exit code | when | errors |", "|---|---|---|"]
    errors = {code: [] for code in EXIT_CODES} | _errors()
    lines += [
        f"| {code} | {when} | {', '.join(f'`{name}`' for name in errors.get(code, []))} |"
        for code, when in EXIT_CODES.items()
    ]
    lines += [
        "",
        _paragraph(
            "Errors are one paragraph on stderr: what, where (file and line, or node and object), what to do. A file"
            " with several problems gets a line for each, ten at most. Results that `--json -` writes go to stdout"
            " and are not mixed with messages."
        ),
    ]
    return "\n".join(lines) + "\n"


def _errors() -> dict[int, list[str]]:
    found: dict[int, list[str]] = {}
    waiting: list[type[Exception]] = [GatewayError, DriveError]
    while waiting:
        error = waiting.pop(0)
        found.setdefault(getattr(error, "exit_code", 1), []).append(error.__name__)
        waiting += [
            each for each in error.__subclasses__() if each.__module__.startswith(("gateway.errors", "drives.errors"))
        ]
    return {code: sorted(names) for code, names in found.items()}


def _periods() -> list[str]:
    """Return the lines on the periods that `record --moving` adds to a recording."""
    return [
        "## Periods",
        "",
        _paragraph(
            "`record --moving` adds one group a period, `/arms/NAME/periods/0003`; visits and periods are numbered"
            " together. The datasets are those of a visit, for every SYNC of the period, and `target_rad` (samples,"
            " axes): the setpoint sent with that SYNC and due at the next."
        ),
        "",
        "| attribute | what it is |",
        "|---|---|",
        "| `load` | label of the mounted load |",
        f"| `excitation`, `name`, `kind` | fingerprint and name of the excitation; {', '.join(KINDS)} |",
        "| `joint` | joint that a sweep turns; 0: all |",
        "| `period` | number of the period, from 1 |",
        "| `period_s` | duration of the period: a whole number of SYNCs |",
        "| `speed` | share of the planned speed |",
        "| `complete`, `incomplete_epochs` | all SYNCs are present; number of those without all answers |",
        "",
        _paragraph(
            "The attributes of `/arms/NAME/excitations` are the excitations themselves (JSON, by fingerprint)."
            " Refused: a period that is marked complete and lacks a SYNC, whose duration is not a whole number of"
            f" SYNCs, or with fewer than {LEAST_PER_HARMONIC} SYNCs for each of its harmonics."
        ),
        "",
        _paragraph(
            "The conversion to a table gives one row per SYNC of every complete period. The torque is as measured."
            " Position, speed and acceleration are computed from the measured positions. For a series they follow"
            f" from a least squares fit of its harmonics over the period, up to {CUTOFF_HZ:g} Hz and at least those"
            f" of the setpoints. For a sweep they follow from a zero-phase low pass (half the power at {CUTOFF_HZ:g}"
            " Hz). They are shifted back by the delay of the torque filter (`filter_s` of the profiles, mean of all"
            " axes). `run` is the name of the file and the number of the period. `x_excitation` identifies rows that"
            " repeat (motion and speed), `x_period` and `x_phase_s` the period and the time in it, `x_motion_hz` the"
            f" {CUTOFF_HZ:g} Hz; rows at rest leave them empty."
        ),
    ]


def _black_box() -> list[str]:
    """Return the lines on the black box files of a stop."""
    fields = ", ".join(f"`{name}`" for name, _ in FIELDS)
    return [
        "## The black box",
        "",
        _paragraph(
            f"While a command moves an arm, a separate process stores the last {KEPT_S:g} s of all samples and"
            " frames. It receives them twice a second; the motion loop never waits for it. A run without a stop"
            " leaves no black box. A recording that is stopped leaves `run.blackbox.h5` and `run.blackbox.blf`"
            " beside `run.h5`, and the message names them; the next stop of the same recording replaces them."
            " Commands without a recording (`move`, `check`, `follow`, `teach`, `run-pair`, the proof of the stop)"
            " leave `CELL-ARM.TIME.blackbox.h5`, one per arm. It is in the folder of the write ledgers"
            f" (`~/.local/state/servo-gateway`), which keeps the newest {MOST_BOXES} of an arm. If the program is"
            " killed, the process writes the files from the data up to a second before. If that process is killed"
            " too, the next run of the recording or `report` writes them. `servo-gateway report run.h5 -o stop.html`"
            " draws the last seconds of every axis, with the stop at t = 0: torque, following error, speed, state of"
            " the drive. Below are the messages of the bus: emergency messages, SDO, NMT, controlwords. `report`"
            " also takes a black box file."
        ),
        "",
        "| in `run.blackbox.h5` | what it is |",
        "|---|---|",
        "| attributes `recording`, `reason`, `created`, `software`, `cell` | origin, and the reason of the stop |",
        "| `wall_s`, `time_s`, `sync_index` (n,) | wall clock, time of the run and number of each SYNC |",
        f"| `/arms/NAME/..` (n, axes) | {fields}; NaN: not answered |",
        "| `/frames/..` (m,) | `time_s` (wall clock), `can_id`, `flags`, `length`, `data`: every frame of the bus,"
        " those of the stop too |",
        "",
        "The BLF file holds the same frames for CAN tools.",
    ]


def recording_page() -> str:
    """Return the page on the content of a recording."""
    lines = [
        "# Recording (HDF5)",
        "",
        _paragraph(
            f"`run.h5`, schema {SCHEMA}. The whole file is written after each visit and period under a temporary"
            " name, synced, then renamed. The file on disk is complete, with a checksum at its end. It contains its"
            " cell, so data of another cell, arm, robot or set of drives are refused. A constant that was corrected"
            " since is used and named."
        ),
        "",
        "| attribute of the file | what it is |",
        "|---|---|",
        "| `schema`, `created`, `software` | version of this layout; date; program and version |",
        "| `cell`, `profiles`, `robot` | text of the cell file, of each drive profile (JSON by name), of the URDF |",
        f"| `exit_status`, `reason` | {', '.join(f'`{word}`' for word in STATUSES)}; and why. Every"
        " result of a recording that is not `success` gives the reason |",
        "",
        "| attribute of `/arms/NAME` | what it is (JSON) |",
        "|---|---|",
        "| `constants`, `identities` | values read from each drive; vendor, product, revision, serial number |",
        "| `ledger` | every object that was written, with its previous value |",
        "| `bus_statistics` | SYNCs, delayed and incomplete ones |",
        "",
        _paragraph(
            "One group a visit, `/arms/NAME/visits/0007`, with the attributes `load`, `pose`, `purpose`, `approach`"
            " (-1, 1), `complete`, `incomplete_epochs`, and these datasets of shape (samples, axes), each with its"
            " `unit`:"
        ),
        "",
        "| dataset | unit |",
        "|---|---|",
        *(f"| `{name}` | {unit} |" for name, (_, unit) in (WORDS | VALUES).items()),
        "| `sync_index`, `time_s` (samples,) | count, s |",
        "",
        _paragraph(
            "A word that the drives do not send is omitted. `servo-gateway export RUN.h5 --format csv` gives the"
            " means as [measured table](measured-table.md); [other formats](../how-to/open-formats.md) hold every"
            " sample."
        ),
        "",
        _paragraph(
            "The attribute `temperature_c` (axes,) of a visit or period is the temperature of motor or drive in deg C."
            " It is read once by SDO during the visit or period, where the drive profile has `[temperature]`. NaN:"
            " the drive has none, or did not answer in time. The attribute is absent if no drive has one."
        ),
        "",
        *_periods(),
        "",
        *_black_box(),
    ]
    return "\n".join(lines) + "\n"
