"""live: a page of what happens on the buses of a cell, whoever moves it."""

from __future__ import annotations

from pathlib import Path

import click

from gateway.commands.shared_options import bus_option, cell_argument, common, session_of


@click.command()
@cell_argument
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="N",
    help="Port of the page on this computer; 8460, or the next free one, if not given.",
)
@click.option(
    "--constants",
    "recording",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="RUN.h5",
    help="Constants of the drives, for a page that is opened after they were read.",
)
@bus_option
@common
def live(cell: Path, port: int | None, recording: Path | None, bus_spec: str | None) -> None:
    """A page of what happens on the bus, until Ctrl-C. It only listens: nothing is sent, nothing moves.

    Every command that moves shows the same page, with a button that stops the arm, when it is given --live.
    """
    from gateway.cell.buses import bus_specs
    from gateway.cell.config import load_cell
    from gateway.live.page import live_page
    from gateway.live.watching import watch

    loaded = load_cell(cell)
    specs = bus_specs(loaded.cell, bus_spec)
    session = session_of()
    with live_page(f"{loaded.cell.name}, watched", port, stops=False) as page:
        session.show(f"live page: {page.address}")
        session.note("it listens and sends nothing; Ctrl-C ends it")
        try:
            watch(loaded, specs, page.feed, recording)
            session.note("ended: the process of the page is gone")
        except KeyboardInterrupt:
            session.note("ended")
