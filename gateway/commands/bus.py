"""Commands `scan`, `check` and `restore`, which communicate with the drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.console import findings_table, grid
from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.shared_options import (
    agreed,
    bus_option,
    cell_argument,
    cell_context,
    common,
    confirm,
    json_option,
    refuse_to_replace,
    reserve,
    session_of,
    write_json,
)
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from drives.discovery import ScanResult
    from gateway.result.result import Finding


DEFAULT_BUS = "socketcan:can0"
#: Number of remaining ledger objects that are listed without -v.
_LISTED = 6


@click.command()
@click.option("--bus", "bus_spec", metavar="SPEC", default=DEFAULT_BUS, show_default=True, help="Bus to scan.")
@click.option(
    "--listen", "listen_s", type=click.FloatRange(0.05, 60.0), default=1.0, show_default=True, help="Seconds."
)
@json_option
@common
def scan(bus_spec: str, listen_s: float, json_out: str | None) -> None:
    """List the nodes on the bus: identity, firmware, NMT state, matching profile. Nothing is written, nothing moves.

    \b
    Example:
      servo-gateway scan --bus socketcan:can0
    """
    from drives.bus import BusSpec, open_bus
    from drives.discovery import scan as scan_bus
    from drives.errors import BusError

    spec = BusSpec.parse(bus_spec)
    reserve(spec)
    with open_bus(spec) as bus:
        nodes = scan_bus(bus, listen_s=listen_s)
    if not nodes:
        advice = "check supply, wiring, termination, bit rate and, by `servo-gateway doctor`, the CAN controller"
        raise BusError(f"{bus_spec}: no node answered", advice=advice)
    columns = ["node", "device", "vendor", "product", "revision", "serial", "firmware", "NMT", "profiles"]
    session_of().show(grid(f"nodes on {bus_spec}", columns, [_node_row(node) for node in nodes], left=len(columns)))
    write_json(json_out, {"schema": 1, "bus": bus_spec, "nodes": [_node_json(node) for node in nodes]})
    twice = [str(node.identity.node_id) for node in nodes if node.devices > 1]
    if twice:
        raise FindingFailed(
            f"{bus_spec}: more than one device answers at node id {', '.join(twice)}: set a unique node id on each "
            f"device"
        )
    unread = [node for node in nodes if node.unread]
    if unread:
        ids = ", ".join(str(node.identity.node_id) for node in unread)
        what = f"{bus_spec}: node {ids} answers, but its identity cannot be read: {unread[0].unread}"
        raise BusError(
            what, advice="scan again; another tool may be using its SDO channel, or the drive lost its supply"
        )


def _node_row(node: ScanResult) -> list[str]:
    who = node.identity
    name = f"{who.node_id}" + (f" ({node.devices} devices)" if node.devices > 1 else "")
    numbers = [
        "-" if value is None else f"0x{value:X}"
        for value in (who.vendor_id, who.product_code, who.revision, who.serial_number)
    ]
    state = "" if node.state is None else str(node.state)
    return [name, who.name or "", *numbers, who.software_version or "", state, ", ".join(node.profiles)]


def _node_json(node: ScanResult) -> dict[str, Any]:
    state = None if node.state is None else str(node.state)
    found: dict[str, Any] = {
        "devices": node.devices,
        "nmt_state": state,
        "profiles": list(node.profiles),
        "unread": node.unread,
    }
    return asdict(node.identity) | found


@click.command()
@cell_argument
@click.option(
    "--move",
    is_flag=True,
    help="Move each joint a little: compare signs, axis order, gear ratios and torque with the model.",
)
@click.option(
    "--prove-stop",
    is_flag=True,
    help="Stop the master's heartbeat during a slow motion and check that the drives stop.",
)
@click.option(
    "--brakes", is_flag=True, help="Test each brake in turn: it holds its axis while the other axes are under power."
)
@click.option("--timing", is_flag=True, help="Measure the timing of each drive: page and one JSON file per drive.")
@click.option("--axis", "axes", multiple=True, metavar="J2", help="With --timing: this drive only; repeatable.")
@click.option(
    "-o",
    "--output",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("timing"),
    show_default=True,
    metavar="FOLDER",
    help="With --timing: folder of page and files.",
)
@arm_option
@bus_option
@json_option
@move_options
@common
def check(
    cell: Path,
    move: bool,
    prove_stop: bool,
    brakes: bool,
    timing: bool,
    axes: tuple[str, ...],
    folder: Path,
    arm_name: str | None,
    bus_spec: str | None,
    json_out: str | None,
    moving: MoveChoice,
) -> None:
    """Check every drive against profile and cell file before motion.

    Nothing is written to a drive and nothing moves unless --move, --prove-stop, --brakes or --timing is given; then it
    asks. With -v also the steps of bring-up before each motion, in their order.

    With --timing the arm moves a little. A drive that fails is named, and nothing moves any more. What was measured is
    written in every case.

    \b
    Examples:
      servo-gateway check cell.toml --prove-stop --move
      servo-gateway check cell.toml --timing -o timing
    """
    from drives.bringup import steps
    from gateway.commands.terminal import terminal
    from gateway.jobs.check import check as check_arm
    from gateway.jobs.check import check_moving
    from gateway.jobs.drive_test import PAGE, measure_timing
    from gateway.model.arm_model import arm_named
    from gateway.preflight.drive_check import require_passed
    from gateway.result.values import plain_values

    if axes and not timing:
        raise click.UsageError("--axis needs --timing")
    context = cell_context(cell, bus_spec, moving.pacing)
    session = session_of()
    arms = context.arms if arm_name is None else (arm_named(context.loaded, arm_name),)
    folders = {arm.name: folder / arm.name if len(arms) > 1 else folder for arm in arms}
    tested = {arm.name: _numbers(axes, len(arm.axis)) for arm in arms} if timing else {}
    for name in tested:
        for file in [PAGE, *(f"J{axis + 1}.json" for axis in tested[name])]:
            refuse_to_replace(folders[name] / file, "-o")
    items = {arm.name: check_arm(context, arm=arm.name) for arm in arms}
    proofs: list[dict[str, Any]] = []
    moves = move or prove_stop or brakes
    try:
        if (moves or timing) and any(line.severity == "fail" for lines in items.values() for line in lines):
            session.note("nothing has moved: correct the failed items first")
            moves = timing = False
        for arm in arms if moves else ():
            with stoppable(moving) as options:
                findings, seen = check_moving(
                    context,
                    terminal(session, moving),
                    options,
                    arm=arm.name,
                    small_moves=move,
                    stop=prove_stop,
                    brakes=brakes,
                )
            items[arm.name] += findings
            proofs += seen
        for arm in arms if timing else ():
            require_passed(items[arm.name], f"arm '{arm.name}': its timing is not measured")
            person, place = terminal(session, moving), folders[arm.name]
            with stoppable(moving) as options:
                reports, failure = measure_timing(context, place, person, options, arm=arm.name, axes=tested[arm.name])
            for report in reports:
                heading = f"{report.axis} node {report.node}: {len(report.findings)} findings"
                session.show("\n  ".join([heading, *report.findings]))
            session.show(f"{place / PAGE}: page of {len(reports)} drives")
            if failure is not None:
                raise failure
    finally:  # a motion that fails or is declined leaves what was found before
        for name, lines in items.items():
            shown = [line for line in lines if session.verbosity > 0 or line.severity in ("warn", "fail")]
            title = f"arm {name}: {_count(lines)}"
            session.show(findings_table(shown, title) if shown else title)
    if session.verbosity > 0:
        order = (f"{number:4d}. {step}" for number, step in enumerate(steps(), start=1))
        session.show("\n".join(["bring-up before each motion, in this order:", *order]))
    findings = plain_values([line for lines in items.values() for line in lines])
    body = {"schema": 1, "cell": context.loaded.cell.name, "findings": findings}
    write_json(json_out, body | ({"stop_proof": proofs} if proofs else {}))
    require_passed([line for lines in items.values() for line in lines], "check failed")


def _numbers(axes: Sequence[str], count: int) -> list[int]:
    """Return the numbers, from 0, of axes such as J2; all if none is named."""
    numbers = {f"J{number + 1}": number for number in range(count)}
    names = [name.upper() for name in axes] or list(numbers)
    if unknown := [name for name in names if name not in numbers]:
        raise click.UsageError(f"--axis: '{unknown[0]}' is not an axis of this arm: give one of {', '.join(numbers)}")
    return [numbers[name] for name in names]


def _count(lines: Sequence[Finding]) -> str:
    count = {kind: sum(line.severity == kind for line in lines) for kind in ("ok", "info", "warn", "fail")}
    return ", ".join(f"{number} {kind}" for kind, number in count.items())


@click.command()
@cell_argument
@click.option(
    "--forget", is_flag=True, help="Remove entries that cannot be restored; they are listed, and you confirm first."
)
@click.option("--yes", is_flag=True, help="Remove entries without asking.")
@bus_option
@json_option
@common
def restore(cell: Path, forget: bool, yes: bool, bus_spec: str | None, json_out: str | None) -> None:
    """Disable drives that are still energised, then restore the parameters recorded in the write ledger.

    A drive in OPERATION ENABLED, QUICK STOP ACTIVE or SWITCHED ON is stopped by its quick stop ramp. Once its
    standstill is read and its brake has had its time to close, its voltage is disabled. Every parameter is read back.

    If a drive does not answer or refuses an object, the others are still restored. The entry stays in the ledger, is
    listed, and the exit code is 4. An object that another tool has written since keeps its value.

    \b
    Example:
      servo-gateway restore cell.toml
    """
    from drives.errors import raise_failures
    from gateway.jobs.configure import restore as restore_drives

    context, session = cell_context(cell, bus_spec), session_of()

    def show_and_forget(restored: dict[str, Any]) -> bool:
        arm, back, left = f"arm {restored['arm']}", restored["put_back"], restored["left"]
        for line in restored["disabled"]:
            session.show(f"{arm}: {line}")
        for entry in back:
            session.note(f"restored: {entry}", level=1)
        session.show(f"{arm}: {len(back)} objects restored" if back or left else f"{arm}: nothing to restore")
        for entry in restored["written_by_others"]:
            session.show(f"  keeps its value, because another tool has written it since: {entry}")
        if not left:
            return False
        session.show(
            f"{arm}: {len(left)} objects remain in the write ledger (original -> written value); remove the cause and"
            " run restore again, or remove them with --forget"
        )
        for entry in left if session.verbosity > 0 else left[:_LISTED]:
            session.show(f"  {entry}")
        if len(left) > _LISTED and session.verbosity <= 0:
            session.show(f"  and {len(left) - _LISTED} more (list them with -v)")
        if forget and not yes:
            question = f"{len(left)} objects of arm '{restored['arm']}' keep their current values."
            confirm(f"{question} Remove them from the ledger?", "declined: the entries stay in the write ledger")
        return forget

    arms, failures = restore_drives(context, same_drive=agreed, forget=show_and_forget)
    write_json(json_out, {"schema": 1, "cell": context.loaded.cell.name, "arms": arms})
    raise_failures(failures)
