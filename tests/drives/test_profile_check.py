"""Data sheets that a profile names are read and compared with it."""

from __future__ import annotations

import pytest

from drives.errors import ProfileError
from drives.profile_file import PROFILE_FOLDER, load_profile, parse_profile

PROFILE = (PROFILE_FOLDER / "generic-cia402.toml").read_text()
SHEET = (PROFILE_FOLDER / "generic-cia402.eds").read_text()


@pytest.fixture
def load(tmp_path):
    def load(sheet, profile=PROFILE):
        (tmp_path / "generic-cia402.eds").write_text(sheet)
        path = tmp_path / "generic-cia402.toml"
        path.write_text(profile)
        return load_profile(path)

    return load


def section(text, name, old, new):
    start = text.index(f"[{name}]")
    end = text.index("\n[", start + 1)
    return text[:start] + text[start:end].replace(old, new) + text[end:]


def test_the_packaged_sheet_fits_the_packaged_profile(load):
    assert load_profile("generic-cia402").eds_path == PROFILE_FOLDER / "generic-cia402.eds"
    assert load(SHEET).name == "generic-cia402"


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("6077", "[6077]", "[5077]", "6077:00 is not in it"),
        ("6077", "DataType=0x0003", "DataType=0x0006", "6077:00 is not of type i16"),
        ("60B2", "PDOMapping=1", "PDOMapping=0", "60B2:00 cannot be mapped"),
        ("608Fsub2", "[608Fsub2]", "[608Fsub3]", "608F:02 is not in it"),
    ],
)
def test_a_contradiction_is_named(load, name, old, new, says):
    with pytest.raises(ProfileError, match=says) as caught:
        load(section(SHEET, name, old, new))
    assert "contradict" in str(caught.value)


def test_all_contradictions_are_named_at_once(load):
    sheet = section(section(SHEET, "6077", "0x0003", "0x0006"), "60B2", "PDOMapping=1", "PDOMapping=0")
    with pytest.raises(ProfileError, match="6077:00.*60B2:00"):
        load(sheet)


@pytest.mark.parametrize("sheet", ["", "no ini", "[6041]\n", "[6041]\nParameterName=x\nDataType=zz\nAccessType=ro\n"])
def test_a_damaged_sheet_is_a_profile_error(load, sheet):
    with pytest.raises(ProfileError):
        load(sheet)


def test_a_missing_sheet_is_a_profile_error(tmp_path):
    with pytest.raises(ProfileError, match="remove the key eds"):
        parse_profile(PROFILE, "mine.toml", tmp_path)


@pytest.mark.parametrize("name", ["../x.eds", "/dev/zero", "a/b.eds", "x.txt"])
def test_a_sheet_is_beside_its_profile(name):
    with pytest.raises(ProfileError, match="eds"):
        parse_profile(PROFILE.replace("generic-cia402.eds", name), "mine.toml")
