"""plan --view: a page that opens offline; what is assumed around the arm is said in the terminal and on the page."""

from pathlib import Path

from click.testing import CliRunner

from gateway.cli import main
from gateway.report.plan import edges

EXAMPLE = Path("examples/small/cell.toml")


def test_a_plan_is_drawn_and_says_what_it_assumes(tmp_path):
    file = tmp_path / "plan.html"
    told = CliRunner().invoke(main, ["plan", str(EXAMPLE), "--poses", "3", "--view", str(file)])
    assert told.exit_code == 0, told.output
    page = file.read_text(encoding="utf-8")
    assert page.count("<svg") == 1 + 3 + 4
    assert "src=" not in page
    assert "href=" not in page
    said = " ".join(told.output.split())
    for text in (page, said):
        assert "floor: -0.02 m, arm.floor_m" in text
        assert "load: a ball of 0.132 m on the flange, assumed; give arm.load_size_m" in text
        assert "link 6 and link 4" in text


def test_a_box_has_twelve_edges_of_its_own_length():
    found = edges((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    lengths = sorted(sum(abs(b - a) for a, b in zip(*edge, strict=True)) for edge in found)
    assert lengths == [1.0] * 4 + [2.0] * 4 + [3.0] * 4
    assert len({frozenset(edge) for edge in found}) == 12
