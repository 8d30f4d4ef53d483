"""Lines of keys, and problems of a file in words: where, what, what to write, all of them."""

import re

import pytest
from pydantic import Field

from drives.toml_lines import key_lines, line_of
from drives.validation import Refused, Strict, Unfit, read_strict

TEXT = '''# a remark with [brackets]
name = "a"   # = no key
[bus.a]
options = { port = 4, deep.er = [1,
  2] }
text = """
[[arm]]
no = 1
"""
[[arm]]
pairs = [[1, 2],
  # [[arm]]
  [3, 4]]
[[arm.axis]]
ratio = { value = 1.5, source = "a = b, [c]" }
day = 1979-05-27 07:32:00
[[arm.axis]]
"odd key".x = 'it is # no remark'
[[arm]]
[[arm.axis]]'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ((), 1),
        (("name",), 2),
        (("bus", "a"), 3),
        (("bus", "a", "options", "port"), 4),
        (("bus", "a", "options", "deep", "er", 1), 5),
        (("arm", 0), 10),
        (("arm", 0, "pairs", 1, 0), 13),
        (("arm", 0, "axis", 0, "ratio", "source"), 15),
        (("arm", 0, "axis", 1), 17),
        (("arm", 0, "axis", 1, "odd key", "x"), 18),
        (("arm", 1), 19),
        (("arm", 1, "axis", 0), 20),
    ],
)
def test_the_line_of_a_key(path, line):
    assert key_lines(TEXT)[path] == line
    assert key_lines(TEXT.replace("\n", "\r\n"))[path] == line


def test_text_in_strings_and_comments_is_no_key():
    assert ("arm", 2) not in key_lines(TEXT)
    assert not [path for path in key_lines(TEXT) if "no" in path]


def test_a_key_that_is_not_there_is_looked_for_in_its_table():
    assert line_of(key_lines(TEXT), ("arm", 0, "axis", 1, "torque", "value")) == 17


class Constant(Strict):
    value: float
    source: str = Field(min_length=1)


class Axis(Strict):
    node: int = Field(ge=1, le=127, description="id of the drive")
    ratio: Constant
    limit: tuple[float, float]
    radius: float | tuple[float, ...] = 1.0

    def model_post_init(self, context: object) -> None:
        if self.limit[0] >= self.limit[1]:
            raise Refused((("limit",), "limit: the lower one first"))


class File(Strict):
    name: str
    axis: tuple[Axis, ...]

    def model_post_init(self, context: object) -> None:
        if len({axis.node for axis in self.axis}) < len(self.axis):
            raise Refused((("axis", 1, "node"), "node: given twice"))


GOOD = """name = "a"
[[axis]]
node = 1
ratio = { value = 2, source = "x" }
limit = [-1, 1]
[[axis]]
node = 2
ratio = { value = 2, source = "x" }
limit = [-1, 1]
"""


def problems(*changes: tuple[str, str]) -> tuple[str, ...]:
    text = GOOD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(Unfit) as unfit:
        read_strict(text, File)
    return unfit.value.messages("f.toml", lambda path: f"J{path[1] + 1}" if len(path) > 1 else "")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("node = 1\n", "", "f.toml line 2, J1: node is missing (id of the drive): write node = 1 to 127"),
        ("node = 1", "node = 0", "f.toml line 3, J1: node = 0 must be at least 1: write node = 1 to 127"),
        ("node = 1", 'node = "1"', 'f.toml line 3, J1: node = "1" is no integer: write node = 1 to 127'),
        ("node = 1", "node = true", "f.toml line 3, J1: node = true is no integer: write node = 1 to 127"),
        (
            'ratio = { value = 2, source = "x" }',
            "ratio = 2",
            'f.toml line 4, J1: ratio = 2 is no table: write ratio = { value = 2, source = "..." }',
        ),
        (
            ', source = "x"',
            "",
            'f.toml line 4, J1: ratio: source is missing: write ratio = { value = 2, source = "..." }',
        ),
        (
            "limit = [-1, 1]",
            "limit = [-1]",
            "f.toml line 5, J1: limit = [-1] is too short, at least 2 are needed: write limit = [NUMBER, NUMBER]",
        ),
        ("limit = [-1, 1]", "limit = [1, -1]", "f.toml line 5, J1: limit: the lower one first"),
        ("limit = [-1, 1]", "limits = [-1, 1]", "f.toml line 5, J1: limits: unknown key (units are part of the name)"),
        ("node = 2", "node = 1", "f.toml line 7, J2: node: given twice"),
        ('name = "a"', "name = a", "f.toml line 1: not valid TOML"),
    ],
)
def test_a_problem_names_line_key_and_what_to_write(old, new, said):
    assert any(line.startswith(said) for line in problems((old, new)))


def test_failed_checks_of_a_table_are_reported_beside_missing_keys():
    found = problems(('name = "a"\n', ""), ("limit = [-1, 1]", "limit = [1, -1]"), ("node = 2", "node = 1"))
    assert [re.sub(r" \(.*", "", line.partition(": ")[2]) for line in found] == [
        'name is missing: write name = "..."',
        "limit: the lower one first",
        "node: given twice",
    ]


def test_what_was_put_in_to_look_further_is_not_complained_of():
    assert len(problems(("limit = [-1, 1]", 'limit = "wide"'))) == 1
    assert len(problems(("node = 1", "node = 0"), ("node = 2", "node = 128"))) == 2


def test_one_problem_on_several_lines_is_reported_once_and_ten_lines_are_the_most():
    found = problems((', source = "x"', ""), (', source = "x"', ""))
    assert found == (
        'f.toml lines 4, 8, J1, J2: ratio: source is missing: write ratio = { value = 2, source = "..." }',
    )
    many = "".join(f"key{number} = 1\n" for number in range(30))
    found = problems(('name = "a"\n', f'name = "a"\n{many}'))
    assert len(found) == 10
    assert all(f"key{number}: " in "\n".join(found) for number in range(30))
