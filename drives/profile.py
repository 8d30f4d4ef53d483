"""Drive profiles: what the master has to know of one drive model, as data (`profiles/*.toml`).

Every constant carries its source. A constant that is missing is an error: nothing is ever taken as 1.0.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from drives.errors import ProfileError
from drives.objects import RPDO_COMMUNICATION, RPDO_MAPPING, TPDO_COMMUNICATION, TPDO_MAPPING
from drives.profile_parts import (
    Constant,
    CountsFromObjects,
    EmcyEntry,
    Feedforward,
    Heartbeat,
    Identity,
    ObjectReference,
    Position,
    Rated,
    Reference,
    SafetyCondition,
    SdoTimes,
    Signal,
    Source,
    StateMachine,
    Strict,
    TorqueOffset,
    Velocity,
    Write,
)
from drives.toml_text import parse_toml
from drives.validation import problems_in_words

__all__ = [
    "PROFILE_FOLDER",
    "Constant",
    "CountsFromObjects",
    "DriveProfile",
    "ObjectReference",
    "Rated",
    "Signal",
    "TorqueOffset",
    "list_profiles",
    "load_profile",
    "parse_profile",
    "profile_schema",
]

PROFILE_FOLDER = Path(__file__).parent / "profiles"

#: And beside them in a run with feedforward.
_FEEDFORWARD_WRITES = (RPDO_COMMUNICATION + 1, RPDO_MAPPING + 1, 0x60B1)


class DriveProfile(Strict):
    """Everything the master has to know of one drive model."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
    description: str
    source: Source
    eds: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*\.eds$")] | None = None
    identity: Identity = Identity()
    torque: Signal
    current: Signal | None = None
    torque_offset: TorqueOffset | None = None
    velocity: Velocity | None = None
    feedforward: Feedforward | None = Field(
        default=None, description="absent: the drive has no 0x60B1, or it is not known how it takes it"
    )
    position: Position
    state_machine: StateMachine
    sdo: SdoTimes
    heartbeat: Heartbeat
    write: Write
    emcy: tuple[EmcyEntry, ...] = ()
    safety: tuple[SafetyCondition, ...] = Field(
        default=(), description="conditions of the safety chain that must hold before the drive is enabled"
    )
    reference: Reference | None = Field(
        default=None, description="absent: the drive cannot tell whether its encoder is referenced"
    )
    _text: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=PROFILE_FOLDER)

    @property
    def text(self) -> str:
        """The TOML this profile was read from, for the recording."""
        return self._text

    @property
    def eds_path(self) -> Path | None:
        """Path of the electronic data sheet, if the profile names one."""
        return None if self.eds is None else self._folder / self.eds

    @property
    def needs_torque_constant(self) -> bool:
        """Whether the measured torque is a current times the torque constant of the cell file."""
        return self.torque.is_current

    def emcy_entry(self, code: int) -> EmcyEntry | None:
        """The entry of an emergency code, None if the profile does not know it."""
        return next((entry for entry in self.emcy if entry.code == code), None)

    @model_validator(mode="after")
    def _consistent(self) -> DriveProfile:
        if self.current is not None and not self.current.is_current:
            raise ValueError("current: kind permille_rated_torque is not a current")
        if self.heartbeat.producer_ms is not None and 0x1017 not in self.write.allow:
            raise ValueError("heartbeat.producer_ms needs 0x1017 in write.allow")
        second = TPDO_COMMUNICATION + 1 in self.write.allow and TPDO_MAPPING + 1 in self.write.allow
        if (self.current is not None or self.torque.object.size_bits > 16) and not second:
            raise ValueError("a second TPDO is needed: write.allow lacks 0x1801 and 0x1A01")
        if self.feedforward is not None:
            self._check_feedforward()
        return self

    def _check_feedforward(self) -> None:
        if self.velocity is None:
            raise ValueError("feedforward needs [velocity]: the velocity offset 0x60B1 is in its unit")
        if self.torque_offset is None and not self.torque.kind.startswith("permille"):
            raise ValueError("feedforward needs [torque_offset]: it is not known what one bit of 0x60B2 is")
        missing = [f"0x{index:04X}" for index in _FEEDFORWARD_WRITES if index not in self.write.allow]
        if missing:
            raise ValueError(f"feedforward needs a second RPDO: write.allow lacks {', '.join(missing)}")


def list_profiles() -> list[str]:
    """Names of the profiles that come with the package, sorted."""
    return sorted(path.stem for path in PROFILE_FOLDER.glob("*.toml"))


def load_profile(name_or_path: str | Path) -> DriveProfile:
    """Read one profile.

    Parameters
    ----------
    name_or_path : str or Path
        A name of `list_profiles`, or the path of a TOML file.

    Raises
    ------
    ProfileError
        No such profile, not TOML, an unknown key, a missing constant; every problem of the file at once.
    """
    path = Path(name_or_path)
    packaged = PROFILE_FOLDER / f"{name_or_path}.toml"
    if path.suffix != ".toml" and packaged.is_file():
        path = packaged
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        known = ", ".join(list_profiles())
        advice = f"give the path of a TOML file or one of {known}"
        raise ProfileError(f"drive profile '{name_or_path}' cannot be read: {error}", advice=advice) from error
    return parse_profile(text, str(path), path.parent)


def parse_profile(text: str, where: str, folder: Path = PROFILE_FOLDER) -> DriveProfile:
    """Validate the text of a profile.

    Parameters
    ----------
    text : str
        TOML.
    where : str
        File name for messages.
    folder : Path
        Where the EDS that the profile names is looked for.

    Raises
    ------
    ProfileError
        Every problem of the file at once.
    """
    try:
        profile = DriveProfile.model_validate(parse_toml(text))
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{where}: not valid TOML: {error}", advice="correct the file") from error
    except ValidationError as error:
        advice = "see drives/profiles/README.md, or `servo-gateway profiles schema`"
        raise ProfileError(f"{where}: {problems_in_words(error)}", advice=advice) from error
    object.__setattr__(profile, "_text", text)
    object.__setattr__(profile, "_folder", folder)
    if profile.eds_path is not None:
        from drives.eds import check_eds  # imported here: it needs the classes of this file

        check_eds(profile, profile.eds_path)
    return profile


def profile_schema() -> dict[str, Any]:
    """JSON schema of the profile file."""
    return DriveProfile.model_json_schema()
