"""A measurement that can be replayed: `--archive` of estimate and diagnose writes it, `replay` computes it again.

The option belongs to the commands that compute a result: they alone know every file and every option it came from. What
is replayed is the command, not a copy of the numbers.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import tempfile
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, cast

import click

from drives.files import replace_file
from gateway.commands.console import Session, grid
from gateway.commands.shared_options import FILE, common, json_option, output_option, session_of, write_json
from gateway.errors import FindingFailed, GatewayError, InputError

if TYPE_CHECKING:
    from gateway.cell.config import LoadedCell
    from gateway.data.archive import Archive
    from gateway.result.result import Result

#: Where the files of a measurement are in the archive, and what was computed from them.
FILES: Final = "files"
RESULT: Final = "result.json"
CERTIFICATE: Final = "certificate.xml"
#: Options that name files to read, as `estimate` and `diagnose` call them.
PATHS: Final = frozenset({"data", "robot", "cell_file", "bare", "holdout"})
#: Options that name files to write: no part of what is computed.
WRITTEN: Final = frozenset({"json_out", "junit_file", "archive"})
_COMMANDS: Final = ("estimate", "diagnose")
_LIBRARIES: Final = ("numpy", "scipy", "h5py", "pydantic")
#: Differences that are listed; more are counted.
_SHOWN: Final = 20

archive_option: Callable[..., Any] = output_option(
    "--archive",
    "archive",
    metavar="FILE.zip",
    help="Store data, cell, options, result and certificate, to be computed again by `replay`.",
)


def store(path: Path, result: Result) -> None:
    """Write the archive of the running command and its result."""
    from gateway.data.archive import Archive, archive_bytes
    from gateway.result.dcc import certificate_xml, software_sha256
    from gateway.result.result import to_json

    context = click.get_current_context()
    options = {name: _plain(name, value) for name, value in context.params.items() if name not in WRITTEN and value}
    read = dict(_files_read(context.params))
    root = Path(os.path.commonpath([real.parent for real in read]))
    names = {real: f"{FILES}/{real.relative_to(root).as_posix()}" for real in read}
    for name in PATHS & set(options):
        given = options[name]
        inside = [names[Path(each).resolve()] for each in ([given] if isinstance(given, str) else given)]
        options[name] = inside[0] if isinstance(given, str) else inside
    files = {names[real]: real.read_bytes() for real in read}
    files[RESULT] = to_json(result).encode()
    if result.loads:
        files[CERTIFICATE] = certificate_xml(result, None, datetime.now(UTC).date()).encode()
    stated = {
        "command": context.command.name,
        "options": options,
        "typed": {names[real]: typed for real, typed in read.items() if typed},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": _versions(),
        "software_sha256": software_sha256(),
    }
    replace_file(path, archive_bytes(Archive(files, stated)))
    session_of().show(f"archive: {path}, {len(files)} files")
    named = [typed for typed in read.values() if Path(typed).is_absolute()]
    if named:
        session_of().note(f"{path}: holds folder names such as {named[0]}: type relative names before you pass it on")


def _plain(name: str, value: Any) -> Any:
    """An option as it is typed; several as a list."""
    from gateway.result.acceptance import Expected

    if isinstance(value, Expected):
        return f"{value.label}={value.mass_kg!r},{value.tolerance_kg!r}"
    if isinstance(value, frozenset):
        return ",".join(sorted(value))
    if isinstance(value, tuple):
        return [_plain(name, each) for each in value]
    return str(value) if isinstance(value, Path) else value


def _versions() -> dict[str, str]:
    from gateway import __version__

    libraries = {name: importlib.metadata.version(name) for name in _LIBRARIES}
    return {"servo-gateway": __version__, "python": platform.python_version(), **libraries}


def _files_read(options: Mapping[str, Any]) -> Iterator[tuple[Path, str]]:
    """Every file that the command has read, and how it was typed; empty for one that another file names."""
    values = [options.get(name) or () for name in sorted(PATHS)]
    typed: list[Path] = [path for value in values for path in ((value,) if isinstance(value, Path) else value)]
    for path in typed:
        yield path.resolve(), str(path)
    if options.get("cell_file") is not None:
        from gateway.cell.config import load_cell

        typed_before = {path.resolve() for path in typed}
        loaded = load_cell(options["cell_file"])
        absolute = [arm.robot for arm in loaded.cell.arm if arm.robot is not None and Path(arm.robot).is_absolute()]
        if absolute:
            raise InputError(
                f"--archive: {options['cell_file']} names {absolute[0]}: write it relative to the cell file"
            )
        for real in _files_of(loaded, options["cell_file"]):
            if real not in typed_before:
                yield real, ""


def _files_of(loaded: LoadedCell, cell: Path) -> Iterator[Path]:
    """Files that a cell names, its calibration and answers, and the DCF of its drives."""
    found = [*_named_by(loaded)]
    found += sorted(cell.resolve().parent.glob(f"{cell.stem}.*.toml"))
    found += sorted(cell.resolve().parent.glob("dcf/**/*.dcf"))
    yield from (path for path in dict.fromkeys(found) if path.is_file())


def _named_by(loaded: LoadedCell) -> Iterator[Path]:
    """Robot, poses and profiles that a cell names beside it."""
    named = [arm.robot for arm in loaded.cell.arm if arm.robot is not None]
    if loaded.cell.poses.file is not None:
        named.append(loaded.cell.poses.file)
    profiles = {axis.profile for arm in loaded.cell.arm for axis in arm.axis}
    named += [name for profile in sorted(profiles) for name in (profile, f"{profile}.toml")]
    yield from map(loaded.path, named)


@click.command()
@click.argument("file", metavar="FILE.zip", type=FILE)
@json_option
@common
def replay(file: Path, json_out: str | None) -> None:
    """Compute a stored measurement again and list what differs; exit 7 where a value differs by more than 1e-9.

    `estimate` and `diagnose` write such a file with --archive. A file of it that is missing or was edited is named.
    """
    from gateway.data.archive import read_archive
    from gateway.result.compare import TOLERANCE, differences
    from gateway.result.values import json_object

    archive = read_archive(file)
    session = session_of()
    stored = json_object(archive.files.get(RESULT, b"").decode("utf-8", "replace"), f"{file}: {RESULT}")
    versions = archive.stated.get("versions")
    for name, version in _versions().items():
        was = versions.get(name) if isinstance(versions, dict) else None
        if was != version:
            session.note(f"{file}: computed with {name} {was}, computed again with {version}")
    with session.working("computing the stored measurement again"):
        again = _computed(archive, file)
    found = differences(stored, again)
    if json_out:
        listed = [{"where": each.where, "stored": each.stored, "again": each.again} for each in found]
        write_json(json_out, {"schema": 1, "file": str(file), "tolerance": TOLERANCE, "differences": listed})
    if found:
        rows = [[each.where, _short(each.stored), _short(each.again)] for each in found[:_SHOWN]]
        session.show(grid("what differs", ["value", "stored", "computed again"], rows, left=1))
        if len(found) > _SHOWN:
            session.show(f"and {len(found) - _SHOWN} more; --json OUT lists all of them")
        raise FindingFailed(f"{file}: {len(found)} values differ by more than {TOLERANCE:g} when computed again")
    session.show(f"{file}: every value is the same within {TOLERANCE:g} when computed again")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _computed(archive: Archive, file: Path) -> dict[str, Any]:
    """The result file that the stored command writes now, with file names as they were typed then."""
    command, words = _command(archive, file)
    with tempfile.TemporaryDirectory(prefix="servo-gateway-replay-") as folder:
        for name, content in archive.files.items():
            path = Path(folder, *PurePosixPath(name).parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        _refuse_outside(archive, Path(folder), file)
        output = Path(folder) / "again.json"
        words = [word.replace(f"{FILES}/", f"{folder}/{FILES}/", 1) if known else word for word, known in words]
        try:
            words += ["--json", str(output)]
            command.main(words, command.name, standalone_mode=False, obj=Session(verbosity=-1))
        except FindingFailed:
            pass
        except click.UsageError as error:
            raise InputError(f"{file}: its options are not those of this version: {error.format_message()}") from error
        except GatewayError as error:
            error.add_note(f"{file} cannot be computed again")
            raise
        text = output.read_text(encoding="utf-8")
        for name, typed in sorted(_typed(archive).items(), key=lambda item: -len(item[0])):
            text = text.replace(json.dumps(f"{folder}/{name}")[1:-1], json.dumps(typed)[1:-1])
    return json.loads(text)


def _refuse_outside(archive: Archive, folder: Path, file: Path) -> None:
    """Refuse a cell that names a file which is not in the archive.

    Raises
    ------
    InputError
    """
    from gateway.cell.config import load_cell

    cell = archive.stated["options"].get("cell_file")
    for path in _named_by(load_cell(folder / cell)) if cell else ():
        if not path.is_relative_to(folder.resolve()):
            raise InputError(f"{file}: {cell} names {path}, which is not in it: the measurement is not complete")


def _typed(archive: Archive) -> dict[str, str]:
    typed = archive.stated.get("typed")
    pairs = typed.items() if isinstance(typed, dict) else ()
    return {name: str(value) for name, value in pairs if name in archive.files}


def _command(archive: Archive, file: Path) -> tuple[click.Command, list[tuple[str, bool]]]:
    """The stored command and its words, each with whether it names a file of the archive.

    Only options of `estimate` and `diagnose` that read are taken, and only files of the archive: replaying writes
    nothing outside a temporary folder.

    Raises
    ------
    InputError
    """
    name, options = archive.stated.get("command"), archive.stated.get("options")
    root = click.get_current_context().find_root()
    command = cast("click.Group", root.command).get_command(root, name) if name in _COMMANDS else None
    if command is None or not isinstance(options, dict):
        raise InputError(f"{file}: command {name!r} is none that is computed again ({', '.join(_COMMANDS)})")
    known = {param.name: param for param in command.params}
    words, arguments = list[tuple[str, bool]](), list[tuple[str, bool]]()
    for key, value in options.items():
        if key not in known or key in WRITTEN:
            raise InputError(f"{file}: option {key!r} is none of {name} that only reads")
        several = isinstance(value, list) and (isinstance(known[key], click.Argument) or known[key].multiple)
        for each in value if several else [value]:
            if not isinstance(each, str | int | float):
                raise InputError(f"{file}: option {key!r} has a value that cannot be typed")
            if key in PATHS and each not in archive.files:
                raise InputError(f"{file}: option {key!r} names {each!r}, which is not in it")
            if isinstance(known[key], click.Argument):
                arguments.append((str(each), True))
            elif isinstance(each, bool):
                words.append((known[key].opts[0], False))
            else:
                words += [(f"{max(known[key].opts, key=len)}={each}", key in PATHS)]
    return command, [*words, *arguments]
