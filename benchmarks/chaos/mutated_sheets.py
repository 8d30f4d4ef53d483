"""Data sheets as makers write them: one sheet that is known object by object, in 1 000 spellings.

A sheet is written from a table, so that what it states is known without any reader. Harmless changes (case, blanks,
number formats, order, short forms, encodings) leave every statement as it is. A damage (a typing error in a key or a
section, a broken number, a lost line) may change statements; the lines that it touched are known.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, replace

Address = tuple[int, int]


@dataclass(frozen=True)
class Stated:
    """What the sheet states about one object."""

    kind: int
    access: str
    mappable: int = 0
    default: int | str = ""
    low: int | str = ""
    high: int | str = ""
    value: int | str = ""


U8, U16, U32, I8, I16, I32, TEXT = 0x5, 0x6, 0x7, 0x2, 0x3, 0x4, 0x9
#: Node of the device configuration file.
NODE_ID = 5


def _array(index: int, *elements: Stated) -> dict[Address, Stated]:
    length = Stated(U8, "ro", default=len(elements))
    return {(index, sub): element for sub, element in enumerate((length, *elements))}


OBJECTS: dict[Address, Stated] = {
    (0x1000, 0): Stated(U32, "ro", default=0x20192),
    (0x1014, 0): Stated(U32, "rw", default="$NODEID+0x80", value="$NODEID+0x80"),
    **_array(0x1018, *(Stated(U32, "ro", default=number) for number in (0x1234, 0x77, 0x20000))),
    **_array(0x1800, Stated(U32, "rw", default="$NODEID+0x180", value="$NODEID+0x180"), Stated(U8, "rw", default=255)),
    (0x2000, 0): Stated(U8, "rw", default=127, low=1, high=127, value=5),
    (0x2008, 0): Stated(TEXT, "rw", default="axis 3, left", value="axis 4"),
    **_array(0x2022, *(Stated(I16, "rw", default=-number, low=-3000, high=3000) for number in (100, 200, 300))),
    (0x6040, 0): Stated(U16, "rww", 1),
    (0x6041, 0): Stated(U16, "ro", 1),
    (0x6060, 0): Stated(I8, "rw", 1, default=8, low=-128, high=127),
    (0x6064, 0): Stated(I32, "ro", 1),
    (0x6072, 0): Stated(U16, "rw", 0, default=1000, low=0, high=3000, value=800),
    (0x6076, 0): Stated(U32, "rw", 0, default=512871),
    (0x6077, 0): Stated(I16, "ro", 1, low=-32768, high=32767),
    (0x607A, 0): Stated(I32, "rww", 1, default=-5),
    **_array(0x608F, Stated(U32, "rw", default=65536, value=65536), Stated(U32, "rw", default=65536, value=4)),
    **_array(0x6091, Stated(U32, "rw", default=1), Stated(U32, "rw", default=1)),
    (0x6502, 0): Stated(U32, "ro", default=0x3ED),
}
#: Elements of one type and default alone may be written in short form.
SHORT = (0x608F, 0x6091)
NAMES = {"ascii": "Position", "latin-1": "Lage \xb0 H\xf6he", "gbk": "\u4f4d\u7f6e\u6570\u5024", "nel": "a\x85b"}


@dataclass
class Line:
    """One line; `damaged` where a damage touched it."""

    text: str
    damaged: bool = False


Block = list[Line]


@dataclass
class Mutated:
    """A sheet as bytes, what was done to it, and the numbers of the lines that a damage touched."""

    seed: int
    content: bytes
    what: list[str]
    damaged_lines: frozenset[int]


def _section(address: Address, stated: Stated, name: str, lone: bool) -> Block:
    index, sub = address
    lines = [f"[{index:04X}]" if lone else f"[{index:04X}sub{sub:X}]", f"ParameterName={name}", "ObjectType=0x7"]
    lines += [f"DataType=0x{stated.kind:04X}", f"AccessType={stated.access}"]
    for key, number in (
        ("DefaultValue", stated.default),
        ("LowLimit", stated.low),
        ("HighLimit", stated.high),
        ("ParameterValue", stated.value),
    ):
        if number != "":
            lines.append(f"{key}={number}")
    lines.append(f"PDOMapping={stated.mappable}")
    return [Line(text) for text in (*lines, "")]


def _short(index: int, elements: list[Stated], name: str) -> list[Block]:
    one = elements[0]
    head = [f"[{index:04X}]", f"ParameterName={name}", "ObjectType=0x8", f"DataType=0x{one.kind:04X}"]
    head += [f"AccessType={one.access}", f"DefaultValue={one.default}", "PDOMapping=0"]
    head += [f"CompactSubObj={len(elements)}", ""]
    values = [f"{sub}={element.value}" for sub, element in enumerate(elements, start=1) if element.value != ""]
    names = [f"[{index:04X}Name]", "NrOfEntries=1", "2=second", "", f"[{index:04X}Denotation]", "NrOfEntries=0", ""]
    blocks = [head, names]
    if values:
        blocks.append([f"[{index:04X}Value]", f"NrOfEntries={len(values)}", *values, ""])
    return [[Line(text) for text in block] for block in blocks]


def blocks_of(name: str, short: bool) -> list[Block]:
    """The sheet as sections."""
    heads = sorted({index for index, _ in OBJECTS})
    lists = ["[OptionalObjects]", f"SupportedObjects={len(heads)}"]
    lists += [f"{number}=0x{index:04X}" for number, index in enumerate(heads, start=1)]
    info = ["[DeviceInfo]", f"VendorName={name}", "VendorNumber=0x1234", "ProductName=drive", "ProductNumber=119"]
    info += ["BaudRate_1000=1", "NrOfRXPDO=4", ""]
    blocks = [
        [Line(text) for text in block] for block in (["[FileInfo]", "FileName=drive.dcf", ""], info, [*lists, ""])
    ]
    for index in heads:
        subs = sorted(sub for first, sub in OBJECTS if first == index)
        if subs == [0]:
            blocks.append(_section((index, 0), OBJECTS[index, 0], name, lone=True))
        elif short and index in SHORT:
            blocks += _short(index, [OBJECTS[index, sub] for sub in subs[1:]], name)
        else:
            head = [f"[{index:04X}]", f"ParameterName={name}", "ObjectType=0x9", f"SubNumber={len(subs)}", ""]
            blocks.append([Line(text) for text in head])
            blocks += [_section((index, sub), OBJECTS[index, sub], name, lone=False) for sub in subs]
    site = ["[DeviceComissioning]", f"NodeID={NODE_ID}", "Baudrate=1000", ""]
    return [*blocks, [Line(text) for text in site]]


# ---------------------------------------------------------------------------------------------------- harmless changes


def _each(blocks: list[Block], chance: float, draw: random.Random) -> list[Line]:
    return [line for block in blocks for line in block if line.text and draw.random() < chance]


def key_case(blocks: list[Block], draw: random.Random) -> None:
    style = draw.choice([str.upper, str.lower, str.swapcase])
    for line in _each(blocks, draw.choice([0.05, 0.5, 1.0]), draw):
        key, mark, rest = line.text.partition("=")
        if mark:
            line.text = f"{style(key)}={rest}"


def section_case(blocks: list[Block], draw: random.Random) -> None:
    for line in _each(blocks, 0.7, draw):
        if line.text.startswith("["):
            name = line.text[1:-1]
            name = draw.choice([name.upper(), name.lower(), f" {name} ", name.replace("sub", " Sub "), name])
            line.text = f"[{name}]" + draw.choice(["", " ", " ; section"])


def blanks(blocks: list[Block], draw: random.Random) -> None:
    for line in _each(blocks, draw.choice([0.1, 1.0]), draw):
        key, mark, rest = line.text.partition("=")
        space = draw.choice(["", " ", "\t", "   "])
        line.text = f"{space}{key}{space}{mark}{space}{rest}{space}" if mark else f"{space}{line.text}{space}"


def number_formats(blocks: list[Block], draw: random.Random) -> None:
    for line in _each(blocks, 0.7, draw):
        key, mark, rest = line.text.partition("=")
        base = rest.removeprefix("$NODEID+")
        try:
            number = int(base, 0)
        except ValueError:
            continue
        if key == "ParameterName" or not mark:
            continue
        if base != rest:
            line.text = f"{key}=" + draw.choice([f"$nodeid + {base}", f"{base}+$NODEID", f"$NODEID+{number}"])
            continue
        zeros = "0" * draw.randint(1, 3)
        sign, size = ("-" if number < 0 else ""), abs(number)
        forms = [f"{sign}{size}", f"{sign}{zeros}{size}", f"{sign}0x{size:X}", f"{sign}0X{size:x}", f"{rest} ; note"]
        line.text = f"{key}={draw.choice([*forms, f'{sign}0x{zeros}{size:x}'])}"


def order(blocks: list[Block], draw: random.Random) -> None:
    draw.shuffle(blocks)


def repeated(blocks: list[Block], draw: random.Random) -> None:
    for block in draw.sample(blocks, 4):
        if len(block) > 2:
            block.insert(draw.randrange(2, len(block)), replace(block[draw.randrange(1, len(block) - 1)]))
    block = draw.choice(blocks)
    blocks.append([replace(line) for line in block])


def additions(blocks: list[Block], draw: random.Random) -> None:
    for _ in range(6):
        block = draw.choice(blocks)
        block.insert(
            draw.randrange(1, len(block) + 1), Line(draw.choice(["; note", "# note", "", "  ;[6064]", "XOrder=7"]))
        )
    more = (
        ["[Comments]", "Lines=7", "Line1=[6064]"],
        ["[0060]", "ParameterName=structure", "ObjectType=0x6", "DataType=0x0007", ""],
        ["[0060sub1]", "ParameterName=part", "DataType=0x0005", "AccessType=ro", "DefaultValue=7"],
        ["[5FF0]", "ParameterName=structure", "ObjectType=0x6", "SubNumber=2"],
        ["[MakersOwn]", "A=1", "DataType=7", ""],
        ["[DummyUsage]", "Dummy0001=0", ""],
    )
    for block in draw.sample(more, 3):
        blocks.insert(draw.randrange(1, len(blocks)), [Line(text) for text in block])


def without_defaults(blocks: list[Block], draw: random.Random) -> None:
    """Keys that are empty, or that CiA 306 lets a sheet leave out because of a default."""
    for block in blocks:
        if "sub" in block[0].text or len(block) > 6:
            block[:] = [line for line in block if line.text not in ("ObjectType=0x7", "PDOMapping=0")]
            if draw.random() < 0.3:
                block.append(Line(draw.choice(["ObjFlags=", "Unit=", "UploadFile="])))


HARMLESS: tuple[Callable[[list[Block], random.Random], None], ...] = (
    key_case,
    section_case,
    blanks,
    number_formats,
    order,
    repeated,
    additions,
    without_defaults,
)

# ------------------------------------------------------------------------------------------------------------- damages


def _typing_error(text: str, draw: random.Random) -> str:
    at = draw.randrange(len(text))
    letter = draw.choice("abcdefghijklmnopqrstuvwxyz0123456789")
    return draw.choice(
        [
            text[:at] + text[at + 1 :],
            text[:at] + letter + text[at:],
            text[:at] + letter + text[at + 1 :],
            text[:at] + text[at : at + 2][::-1] + text[at + 2 :],
        ]
    )


def _objects(blocks: list[Block]) -> list[Block]:
    return [block for block in blocks if block[0].text[1:2].isdigit()]


def _keyed(block: Block, *keys: str) -> list[Line]:
    return [line for line in block[1:] if line.text.partition("=")[0] in keys]


VALUES = ("DefaultValue", "LowLimit", "HighLimit", "ParameterValue")
PLAIN = ("DataType", "AccessType", "PDOMapping", "ObjectType", "SubNumber", "CompactSubObj")


def wrong_key(blocks: list[Block], draw: random.Random) -> None:
    line = draw.choice([line for block in _objects(blocks) for line in _keyed(block, *VALUES, *PLAIN)])
    key, _, rest = line.text.partition("=")
    line.text, line.damaged = f"{_typing_error(key, draw)}={rest}", True


def wrong_section(blocks: list[Block], draw: random.Random) -> None:
    line = draw.choice(_objects(blocks))[0]
    line.text, line.damaged = f"[{_typing_error(line.text[1:-1], draw)}]", True


def wrong_number(blocks: list[Block], draw: random.Random) -> None:
    keys = ("DataType", "PDOMapping", "ObjectType", *VALUES)
    numbers = [line for block in _objects(blocks) for line in _keyed(block, *keys) if "axis" not in line.text]
    line = draw.choice(numbers)
    key, _, rest = line.text.partition("=")
    wrong = ["0xZZ", "1.5", "--5", "0x", "zero", f"{rest}x", "1 2,3", "1e3", "99999999999999999999999"]
    line.text, line.damaged = f"{key}={draw.choice(wrong)}", True


def empty_number(blocks: list[Block], draw: random.Random) -> None:
    line = draw.choice([line for block in _objects(blocks) for line in _keyed(block, *PLAIN)])
    line.text, line.damaged = line.text.partition("=")[0] + "=", True


def lost_key(blocks: list[Block], draw: random.Random) -> None:
    block = draw.choice([block for block in _objects(blocks) if _keyed(block, "DataType")])
    line = draw.choice(_keyed(block, "DataType", "AccessType"))
    block.remove(line)
    block[0].damaged = True


def lost_header(blocks: list[Block], draw: random.Random) -> None:
    block = draw.choice(_objects(blocks)[1:])
    before = blocks[blocks.index(block) - 1]
    before[0].damaged = True
    del block[0]
    for line in block:
        line.damaged = True


def lost_bracket(blocks: list[Block], draw: random.Random) -> None:
    line = draw.choice(_objects(blocks))[0]
    line.text, line.damaged = draw.choice([line.text[:-1], line.text[1:]]), True


def lost_mark(blocks: list[Block], draw: random.Random) -> None:
    line = draw.choice([line for block in _objects(blocks) for line in _keyed(block, *VALUES, *PLAIN)])
    line.text, line.damaged = line.text.replace("=", " ", 1), True


def two_values(blocks: list[Block], draw: random.Random) -> None:
    block = draw.choice([block for block in _objects(blocks) if _keyed(block, *VALUES, "DataType")])
    line = draw.choice(_keyed(block, *VALUES, "DataType"))
    block.insert(1, Line(line.text.partition("=")[0] + "=3", damaged=True))


def lost_parent(blocks: list[Block], draw: random.Random) -> None:
    parents = [block for block in _objects(blocks) if _keyed(block, "SubNumber")]
    block = draw.choice(parents)
    after = blocks[(blocks.index(block) + 1) % len(blocks)]
    after[0].damaged = True
    blocks.remove(block)


def lost_section(blocks: list[Block], draw: random.Random) -> None:
    block = draw.choice([block for block in _objects(blocks) if "Name" not in block[0].text and len(block) > 5])
    if "Denotation" not in block[0].text and "Value" not in block[0].text:
        blocks.remove(block)


def too_many(blocks: list[Block], draw: random.Random) -> None:
    for block in _objects(blocks):
        for line in _keyed(block, "CompactSubObj", "SubNumber"):
            line.text, line.damaged = line.text.partition("=")[0] + f"={draw.choice([255, 3_000_000, 10**20])}", True


DAMAGES: tuple[Callable[[list[Block], random.Random], None], ...] = (
    wrong_key,
    wrong_section,
    wrong_number,
    empty_number,
    lost_key,
    lost_header,
    lost_bracket,
    lost_mark,
    two_values,
    lost_parent,
    lost_section,
    too_many,
)

# ----------------------------------------------------------------------------------------------------------- encodings


def _encoded(text: str, name: str, draw: random.Random) -> tuple[bytes, str]:
    if name == "gbk":
        return text.encode("gbk"), "gbk"
    if name == "nel":
        return text.encode("latin-1"), "latin-1 with 0x85"
    if name == "latin-1":
        return text.encode("latin-1"), "latin-1"
    mark = {"utf-8": b"", "utf-8-sig": b"", "utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}
    encoding = draw.choice(list(mark))
    with_mark = draw.random() < 0.7
    return (mark[encoding] if with_mark else b"") + text.encode(encoding), encoding


def mutated(seed: int) -> Mutated:
    """The sheet in the spelling of a seed: up to four harmless changes, a damage in two of three, an encoding."""
    draw = random.Random(seed)
    name = draw.choice(list(NAMES))
    short = draw.random() < 0.4
    blocks = blocks_of(NAMES[name], short)
    what = [f"name {name}", "short form" if short else "long form"]
    if seed % 3:
        damage = DAMAGES[seed % len(DAMAGES)] if draw.random() < 0.5 else draw.choice(DAMAGES)
        damage(blocks, draw)
        what.append(damage.__name__)
    for change in draw.sample(HARMLESS, draw.randint(0, 4)):
        change(blocks, draw)
        what.append(change.__name__)
    lines = [line for block in blocks for line in block]
    end = draw.choice(["\n", "\r\n", "\r"])
    text = end.join(line.text for line in lines) + draw.choice(["", end, "\x1a", f"{end}\x1a{end}", "\0\0"])
    content, encoding = _encoded(text, name, draw)
    damaged = frozenset(number for number, line in enumerate(lines, start=1) if line.damaged)
    return Mutated(seed, content, [*what, encoding], damaged)
