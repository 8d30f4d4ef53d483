"""plan --view: a page that opens offline; what is assumed around the arm is said in the terminal and on the page."""

import re
import shutil
from pathlib import Path

from click.testing import CliRunner

from gateway.cli import main

EXAMPLE = Path("examples/small/cell.toml")


def test_a_plan_is_drawn_and_says_what_it_assumes(tmp_path):
    file = tmp_path / "plan.html"
    done = CliRunner().invoke(main, ["plan", str(EXAMPLE), "--poses", "3", "--view", str(file)])
    assert done.exit_code == 0, done.output
    page = file.read_text(encoding="utf-8")
    assert page.count("<svg") == 1 + 3 + 4
    (arm,) = re.findall(r'<polyline class="link arm"[^>]* points="([^"]+)"><title>arm at pose 1</title>', page)
    assert len(arm.split()) == 1 + 6 + 1, "base, six joints, flange: the arm is in the large view"
    assert len(set(arm.split())) > 3
    assert "src=" not in page
    assert "href=" not in page
    said = " ".join(done.output.split())
    for text in (page, said):
        assert "floor: -0.02 m, arm.floor_m" in text
        assert "load: a ball of 0.132 m on the flange, assumed; give arm.load_size_m" in text
        assert "link 6 and link 4" in text


def test_a_cell_is_drawn_where_its_file_names_a_posture(tmp_path):
    folder = tmp_path / "small"
    shutil.copytree(EXAMPLE.parent, folder)
    done = CliRunner().invoke(main, ["cell", "view", str(folder / "cell.toml")])
    assert done.exit_code == 0, done.output
    page = (folder / "cell.html").read_text(encoding="utf-8")
    for name in ("all joints at 0", "home", "loading", "z 0.2 m"):
        assert f">{name}</text>" in page
    assert page.count('<polyline class="ring"') == 2 * 12, "the edges of two boxes"
    assert "floor: -0.02 m, arm.floor_m" in page
    assert "column: radius 0.12 m" in " ".join(done.output.split())
