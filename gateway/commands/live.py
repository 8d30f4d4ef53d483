"""Command `live`: page with the state of the arms of a cell, observed on its buses."""

from __future__ import annotations

from pathlib import Path

import click

from gateway.commands.shared_options import FILE, bus_option, cell_argument, common, session_of


@click.command()
@cell_argument
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="N",
    help="Port of the page on this computer; default: 8460 or the next free one.",
)
@click.option(
    "--constants",
    "recording",
    type=FILE,
    metavar="RUN.h5",
    help="Constants of the drives, for pages opened later.",
)
@bus_option
@common
def live(cell: Path, port: int | None, recording: Path | None, bus_spec: str | None) -> None:
    """Show the arms of a cell in a browser until Ctrl-C. The bus is only read: nothing is sent, nothing moves.

    Commands that move an arm show the same page with --live, then with a button that stops the arm.

    \b
    Example:
      servo-gateway live cell.toml
    """
    from gateway.cell.buses import bus_specs
    from gateway.cell.config import load_cell
    from gateway.live.page import LivePage
    from gateway.live.watching import watch

    loaded = load_cell(cell)
    specs = bus_specs(loaded.cell, bus_spec)
    session = session_of()
    with LivePage(f"{loaded.cell.name}, watched", port, stops=False) as page:
        session.show(f"live page: {page.address}")
        session.note("read only, nothing is sent; end with Ctrl-C")
        try:
            watch(loaded, specs, page.feed, recording)
            session.note("ended: the process of the page has stopped")
        except KeyboardInterrupt:
            session.note("ended")
