"""A measurement that can be replayed: `store` writes its data and the call that computed it, `replay` repeats the call.

What is replayed is a call of `gateway.api.estimate` or `diagnose` with its arguments, not a copy of the numbers.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ArgsKwargs, to_jsonable_python

from drives.files import replace_file
from gateway import __version__
from gateway.api.analysis import Say, Working, diagnose, estimate, paths_of
from gateway.cell.config import LoadedCell, load_cell
from gateway.data.archive import Archive, archive_bytes, read_archive
from gateway.errors import GatewayError, InputError
from gateway.result.compare import Difference, differences
from gateway.result.dcc import certificate_xml, software_sha256
from gateway.result.result import Result, to_dict, to_json
from gateway.result.values import json_object

#: What was computed from the files of the archive.
RESULT: Final = "result.json"
#: Arguments that name files to read: of the function, and of its `model`.
_PATHS: Final = ("data", "holdout")
_MODEL_PATHS: Final = ("robot", "cell", "bare")
_COMMANDS: Final[Mapping[str, Any]] = {"estimate": estimate, "diagnose": diagnose}


def store(path: Path, result: Result, command: str, arguments: Mapping[str, Any]) -> Archive:
    """Write every file that an analysis has read, its arguments and its result to a zip file, to be replayed.

    Parameters
    ----------
    path : Path
        File to write.
    result : Result
        As the analysis returned it.
    command : str
        Name of the function of `gateway.api`: `estimate` or `diagnose`.
    arguments : mapping of str to object
        Its arguments by name, `data` and `model` among them; not `say` and `working`.

    Returns
    -------
    Archive
        As written; `stated["typed"]` holds the stated name of each file.

    Raises
    ------
    InputError
        The cell names its robot by an absolute path.
    """
    model = arguments["model"]
    given = {key: paths_of(arguments[key]) for key in _PATHS if key in arguments}
    of_model = {key: named for key in _MODEL_PATHS if (named := getattr(model, key)) is not None}
    read = {each.resolve(): str(each) for paths in (*given.values(), of_model.values()) for each in paths}
    for real in () if model.cell is None else _files_of(model.cell):
        read.setdefault(real, "")
    root = Path(os.path.commonpath([real.parent for real in read]))
    names = {real: f"files/{real.relative_to(root).as_posix()}" for real in read}
    options = to_jsonable_python(arguments)
    options |= {key: [names[each.resolve()] for each in paths] for key, paths in given.items()}
    options["model"] |= {key: names[each.resolve()] for key, each in of_model.items()}
    files = {names[real]: real.read_bytes() for real in read}
    files[RESULT] = to_json(result).encode()
    if result.loads:
        files["certificate.xml"] = certificate_xml(result, None, datetime.now(UTC).date()).encode()
    stated = {
        "command": command,
        "options": options,
        "typed": {names[real]: name for real, name in read.items() if name},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": _versions(),
        "software_sha256": software_sha256(),
    }
    archive = Archive(files, stated)
    replace_file(path, archive_bytes(archive))
    return archive


def _versions() -> dict[str, str]:
    libraries = {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "h5py", "pydantic")}
    return {"servo-gateway": __version__, "python": platform.python_version(), **libraries}


def _files_of(cell: Path) -> Iterator[Path]:
    """Return the files that a cell names, its calibration and answers, and the DCF of its drives."""
    loaded = load_cell(cell)
    for arm in loaded.cell.arm:
        if arm.robot is not None and Path(arm.robot).is_absolute():
            raise InputError(f"--archive: {cell} names {arm.robot}: write it relative to the cell file")
    beside = cell.resolve().parent
    found = [*_named_by(loaded), *sorted(beside.glob(f"{cell.stem}.*.toml")), *sorted(beside.glob("dcf/**/*.dcf"))]
    yield from (path for path in dict.fromkeys(found) if path.is_file())


def _named_by(loaded: LoadedCell) -> Iterator[Path]:
    """Return robot, poses and profiles that a cell names beside it."""
    named = [arm.robot for arm in loaded.cell.arm if arm.robot is not None]
    if loaded.cell.poses.file is not None:
        named.append(loaded.cell.poses.file)
    profiles = {axis.profile for arm in loaded.cell.arm for axis in arm.axis}
    named += [name for profile in sorted(profiles) for name in (profile, f"{profile}.toml")]
    yield from map(loaded.path, named)


def replay(
    file: Path, *, say: Say = lambda _text: None, working: Working = lambda _name: nullcontext()
) -> tuple[Difference, ...]:
    """Compute a stored measurement again in a temporary folder, and return every value that differs.

    Parameters
    ----------
    file : Path
        As `store` writes it.
    say : callable
        Shows which versions differ from those of the stored result.
    working : callable
        Called with the name of the computation; open until that is done.

    Returns
    -------
    tuple of Difference
        Empty where every number is equal within `gateway.result.compare.TOLERANCE`.

    Raises
    ------
    InputError
        A file of it is missing or was edited, or it holds arguments that this version does not take.
    DataUnusable, ConfigError
        It cannot be computed again.
    """
    archive = read_archive(file)
    stored = json_object(archive.files.get(RESULT, b"").decode("utf-8", "replace"), f"{file}: {RESULT}")
    versions = archive.stated.get("versions")
    for name, version in _versions().items():
        was = versions.get(name) if isinstance(versions, dict) else None
        if was != version:
            say(f"{file}: computed with {name} {was}, computed again with {version}")
    with working("computing the stored measurement again"):
        return differences(stored, _computed(archive, file))


def _computed(archive: Archive, file: Path) -> dict[str, Any]:
    """Return the result file that the stored call gives now, with file names as they were typed then.

    Raises
    ------
    InputError
        An argument is unknown or of the wrong kind, or names a file that is not in the archive.
    """
    name, options = archive.stated.get("command"), archive.stated.get("options")
    analyse = _COMMANDS.get(name) if isinstance(name, str) else None
    model = options.get("model") if isinstance(options, dict) else None
    if analyse is None or not isinstance(options, dict) or not isinstance(model, dict):
        raise InputError(f"{file}: command {name!r} is none that is computed again ({', '.join(_COMMANDS)})")
    with tempfile.TemporaryDirectory(prefix="servo-gateway-replay-") as folder:
        for member, content in archive.files.items():
            path = Path(folder, *PurePosixPath(member).parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

        def inside(key: str, stated: Any) -> str:
            if not isinstance(stated, str) or stated not in archive.files:
                raise InputError(f"{file}: option {key!r} names {stated!r}, which is not in it")
            return f"{folder}/{stated}"

        named = {key: inside(key, model[key]) for key in _MODEL_PATHS if model.get(key) is not None}
        listed = {key: options[key] if isinstance(options[key], list) else [None] for key in _PATHS if key in options}
        given = {key: [inside(key, each) for each in paths] for key, paths in listed.items()}
        for path in _named_by(load_cell(Path(named["cell"]))) if "cell" in named else ():
            if not path.is_relative_to(Path(folder).resolve()):
                said = f"{file}: {model['cell']} names {path}, which is not in it: the measurement is not complete"
                raise InputError(said)
        call = TypeAdapter(analyse, config=ConfigDict(extra="forbid"))
        try:
            result = call.validate_python(ArgsKwargs((), {**options, **given, "model": {**model, **named}}))
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            where = ".".join(map(str, problem["loc"]))
            raise InputError(f"{file}: option {where} is not one of this version: {problem['msg']}") from error
        except GatewayError as error:
            error.add_note(f"{file} cannot be computed again")
            raise
        text = json.dumps(to_dict(result))
        typed = archive.stated.get("typed")
        pairs = [each for each in (typed.items() if isinstance(typed, dict) else ()) if each[0] in archive.files]
        for member, name in sorted(pairs, key=lambda item: -len(item[0])):
            text = text.replace(json.dumps(f"{folder}/{member}")[1:-1], json.dumps(str(name))[1:-1])
    return json.loads(text)
