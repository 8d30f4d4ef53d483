"""A run as it is kept for the report, checked when it is read: the page is drawn from these numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from gateway.errors import InputError

#: Largest number that any run has, in whatever unit.
LARGEST = 1e9


def _plausible(value: float) -> float:
    if abs(value) > LARGEST:
        raise ValueError(f"{value:g} is no number of a run")
    return value


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds a character that cannot be printed")
    return text


_Text = Annotated[str, AfterValidator(_printable)]
#: NaN stands where a force was not known.
_Known = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_plausible)]
_Sample = Annotated[float, AfterValidator(_plausible)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True)


class _Cycle(_Strict):
    force_n: _Known | None = None
    moment_nm: _Known | None = None
    gap_m: _Known | None = None
    knots: int | None = Field(default=None, ge=0, le=LARGEST)


class _Run(_Strict):
    name: _Text
    text: _Text
    speed: _Known
    s_m: list[_Known] = Field(min_length=2)
    x_m: list[_Known]
    first_n: list[_Sample] = Field(default_factory=list)
    last_n: list[_Sample] = Field(default_factory=list)
    first_m: list[_Known | None] = Field(default_factory=list)
    last_m: list[_Known | None] = Field(default_factory=list)
    knots_s_m: list[_Known]
    cycles: list[_Cycle]

    @model_validator(mode="after")
    def _of_one_length(self) -> _Run:
        if bool(self.last_n) == bool(self.last_m):
            raise ValueError("either last_n or last_m is needed")
        first, last = (self.first_n, self.last_n) if self.last_n else (self.first_m, self.last_m)
        lengths = {len(values) for values in (self.s_m, self.x_m, last, first or self.s_m)}
        if len(lengths) > 1:
            raise ValueError("s_m, x_m, first and last differ in length")
        return self


def check_run(body: Mapping[str, Any], where: str) -> None:
    """Make sure that a stored run can be drawn.

    Raises
    ------
    InputError
        A key is missing or of the wrong kind; the first one is named.
    """
    try:
        _Run.model_validate(body)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"]) or "file"
        raise InputError(f"{where}: {key}: {first['msg']}; is not what this program writes, delete it") from error
