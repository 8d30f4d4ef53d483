"""Files that are replaced whole: what happens with links, devices, permissions and two writers at once."""

import os
import stat
import threading
from pathlib import Path

import pytest

from drives.files import replace_file

CONTENTS = [letter * 200_000 for letter in "ab"]


def everything_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_link_is_replaced_and_the_file_behind_it_keeps_its_content(tmp_path):
    other, path = tmp_path / "other", tmp_path / "result.json"
    other.write_text("kept")
    path.symlink_to(other)
    replace_file(path, "new")
    assert (other.read_text(), path.read_text(), path.is_symlink()) == ("kept", "new", False)


def test_no_existing_link_in_the_folder_is_written_through(tmp_path):
    other = tmp_path / "other"
    other.write_text("kept")
    for name in (".result.json.tmp", "result.json.tmp", f"result.json.{os.getpid()}", f".result.json.{os.getpid()}"):
        (tmp_path / name).symlink_to(other)
    before = everything_in(tmp_path)
    replace_file(tmp_path / "result.json", "new")
    assert other.read_text() == "kept"
    assert everything_in(tmp_path) == sorted([*before, "result.json"])


@pytest.mark.parametrize("linked", [False, True], ids=["itself", "behind a link"])
def test_a_pipe_stays_a_pipe(tmp_path, linked):
    pipe = path = tmp_path / "pipe"
    os.mkfifo(pipe)
    if linked:
        path = tmp_path / "link"
        path.symlink_to(pipe)
    with pytest.raises(OSError, match="only a regular file is replaced") as error:
        replace_file(path, "new")
    assert error.value.filename == str(path)
    assert stat.S_ISFIFO(path.stat().st_mode)
    assert not [name for name in everything_in(tmp_path) if name not in ("pipe", "link")]


def test_a_device_stays_a_device(tmp_path):
    path = tmp_path / "out.json"
    path.symlink_to("/dev/null")
    with pytest.raises(OSError, match="only a regular file is replaced"):
        replace_file(path, "new")
    assert path.readlink() == Path("/dev/null")


def test_the_mode_of_a_file_is_kept_and_a_new_one_is_not_wider_than_the_mask(tmp_path):
    path, new = tmp_path / "result.json", tmp_path / "new.json"
    path.write_text("old")
    path.chmod(0o640)
    replace_file(path, "new")
    replace_file(new, "new")
    plain = tmp_path / "plain"
    plain.write_text("")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert new.stat().st_mode == plain.stat().st_mode


def test_two_writers_never_leave_a_mixture(tmp_path):
    path, seen, done = tmp_path / "result.json", [], threading.Event()
    replace_file(path, CONTENTS[0])

    def write(content):
        for _ in range(25):
            replace_file(path, content)

    def look():
        while not done.is_set():
            seen.append(path.read_text())

    writers = [threading.Thread(target=write, args=[content]) for content in CONTENTS]
    reader = threading.Thread(target=look)
    for thread in (reader, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    done.set()
    reader.join()
    assert seen
    assert all(text in CONTENTS for text in seen)
    assert everything_in(tmp_path) == ["result.json"]
