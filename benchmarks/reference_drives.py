"""Pages of the reference about drives: those of the package, and the questions of a draft."""

from __future__ import annotations

from typing import Final

from benchmarks.toml_words import kind_in_words
from drives.draft.answers import ProfileAnswers
from drives.draft.questions import QUESTIONS
from drives.profile import DriveProfile, Signal
from drives.profile_file import list_profiles, load_profile


def answers_page() -> str:
    """What `profiles new` asks, and how to find out."""
    lines = [
        "# Questions of a profile draft",
        "",
        "What an EDS or DCF cannot say, as `servo-gateway profiles new` asks it at a terminal, takes it with",
        "`--answer KEY=VALUE`, or reads it from a file with `--answers FILE` (TOML, one key each). Whatever is left",
        "out stays open; with an open question about the torque the drive is read and not moved.",
        "",
        "| key | answer | value |",
        "|---|---|---|",
        *(
            f"| `{key}` | {info.description} | {kind_in_words(info.annotation)} |"
            for key, info in ProfileAnswers.model_fields.items()
        ),
    ]
    for question in QUESTIONS:
        lines += ["", f"## `{question.key}`", "", question.asks, "", *(f"- {method}" for method in question.ways)]
    return "\n".join(lines) + "\n"


ARITHMETIC: Final = {
    "permille_rated_torque": "word / 1000 x rated torque",
    "permille_rated_current": "word / 1000 x rated current x Kt",
    "milliampere": "word / 1000 A x Kt",
    "internal_unit": "word x unit x Kt",
}


def drives_page() -> str:
    """Return the page of packaged profiles: drive, conversion of the torque word, source, and whether it is moved."""
    profiles = [load_profile(name) for name in list_profiles()]
    lines = [
        "# Drives of the package",
        "",
        "The conversion of the torque word in each profile, and its source. Sources are the `standard`, the",
        "manufacturer's `manual`, a trial on the drive (`measured`), public `code` for it, or none (`assumed`). No",
        "profile was tried on a real drive yet; its comments list the verified facts",
        "(`servo-gateway profiles show NAME`). Another drive: [drive models](../how-to/drive-profiles.md).",
        "",
        "| profile | drive | torque | source | moved |",
        "|---|---|---|---|---|",
        *(_drive_row(profile) for profile in profiles),
        "",
        "## Read and not moved",
        "",
        "`scan` and `check` read these; every command that moves refuses them with the reason (exit 3).",
        "",
    ]
    for profile in profiles:
        lines += [f"- `{profile.name}`: {obstacle}." for obstacle in profile.obstacles]
    lines += ["", "## Sources", "", *(f"- `{profile.name}`: {profile.source}." for profile in profiles)]
    return "\n".join(lines) + "\n"


def _drive_row(profile: DriveProfile) -> str:
    signal = profile.torque
    where = f"0x{signal.object.index:04X}" + (f":{signal.object.subindex:02X}" if signal.object.subindex else "")
    rated = _rated_words(signal)
    torque = f"{where}: {ARITHMETIC[signal.kind]}" + (f" ({rated})" if rated else "")
    cells = (f"`{profile.name}`", profile.description, torque, str(signal.basis), "no" if profile.obstacles else "yes")
    return f"| {' | '.join(cells)} |"


def _rated_words(signal: Signal) -> str:
    unit = "A" if signal.is_current else "Nm"
    words = []
    if signal.rated is not None and signal.rated.object is not None:
        sub = f":{signal.rated.object.subindex:02X}" if signal.rated.object.subindex else ""
        words.append(f"0x{signal.rated.object.index:04X}{sub} x {signal.rated.unit:g} {unit}")
    elif signal.rated is not None:
        words.append(f"{signal.rated.value:g} {unit}")
    if signal.internal_unit_a is not None:
        words.append(f"{signal.internal_unit_a.value:.6g} A")
    if signal.is_current:
        words.append(f"{signal.current_reference or 'rms or peak is not known'}")
    return ", ".join(words)
