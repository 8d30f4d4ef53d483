"""Status that a drive reports besides its state, epoch by epoch."""

from __future__ import annotations

import contextlib
import time
from types import SimpleNamespace

import pytest

from drives.cia402 import REMOTE
from drives.emcy import EmcyLog
from drives.epoch import Epoch
from drives.errors import DriveFault
from drives.exchange import Timing
from drives.monitor import SAME_IN_A_ROW, SETTLED_SYNCS, Monitor
from drives.profile import DriveProfile
from drives.profile_file import load_profile, parse_profile
from drives.reactions import DRIVE_RULES
from drives.scaling import Constants, MotorScale
from drives.sdo import Posted
from drives.values import DriveReading

ENABLED = 0x0237
GENERIC = load_profile("generic-cia402")
COUNT_RAD = 6.283185307179586 / 65536
#: Rows until an answer that stays the same has been compared with SDO.
LATEST = SAME_IN_A_ROW + SETTLED_SYNCS + 2


class Rig:
    """Two drives whose SDO answers are `truth`, (position, torque) by axis."""

    def __init__(self, pacing: str, profile: DriveProfile = GENERIC) -> None:
        self.truth = [(1000, 10), (2000, 20)]
        drives = tuple(self._drive(axis, profile) for axis in range(2))
        timing = Timing(0.01, pacing)  # type: ignore[arg-type]
        exchange = SimpleNamespace(drives=drives, timing=timing, unanswered=[0, 0], statuswords=[None, None])
        bus = SimpleNamespace(foreign={}, foreign_count=0, bus_off=False)
        watch = SimpleNamespace(contrary={}, booted=set(), lost=tuple, forgive=lambda: None)
        self.emcy = EmcyLog({2: profile})
        self.monitor = Monitor(bus, exchange, watch, self.emcy)  # type: ignore[arg-type]
        self.bits_in_a_row = DRIVE_RULES["internal_limit"].syncs(timing.period_s, pacing)
        self.statuswords: list[int | None] = exchange.statuswords
        self.asked = self._index = 0
        self.deaf = False

    def _drive(self, axis: int, profile: object) -> SimpleNamespace:
        def post(index: int, subindex: int, data_type: str) -> Posted:
            self.asked += 1
            posted = Posted(data_type, time.monotonic() + (0.0 if self.deaf else 60.0))
            if not self.deaf:
                posted.value, posted.answered = self.truth[axis][index == profile.torque.object.index], True
            return posted

        return SimpleNamespace(
            node_id=axis + 1,
            setup=SimpleNamespace(profile=profile),
            access=SimpleNamespace(sdo=SimpleNamespace(post=post)),
            scale=MotorScale(0.01, None, None, COUNT_RAD, None, Constants(1.0, None, None, 4096.0)),
            plans=(None, SimpleNamespace(mapping=0x1A00)),
        )

    def checks(self, *epochs: tuple[tuple[int, int, int] | None, ...]) -> None:
        """Several epochs."""
        for answers in epochs:
            self.check(*answers)

    def check(self, *answers: tuple[int, int, int] | None) -> None:
        """One epoch of (statusword, position, torque) per axis."""
        self._index += 1
        self.statuswords[:] = [None if answer is None else answer[0] for answer in answers]
        readings = tuple(
            None if answer is None else DriveReading(axis + 1, self._index, *answer, None, None, 0.0, 0.0, None, None)
            for axis, answer in enumerate(answers)
        )
        self.monitor.check(Epoch(self._index, 0.0, readings))


@pytest.fixture(params=["lockstep", "real"])
def rig(request: pytest.FixtureRequest) -> Rig:
    return Rig(request.param)


@pytest.mark.parametrize(("word", "other", "bit"), [(0x0A37, 0x2237, 11), (0x2237, 0x0037, 13), (0x0037, 0x0A37, 9)])
def test_a_bit_that_stays_set_stops_and_one_that_flickers_does_not(rig: Rig, word: int, other: int, bit: int) -> None:
    """Nor do bits that take turns: each is counted alone."""
    for number in range(20):
        turn, later = divmod(number, rig.bits_in_a_row)
        rig.check((word if later else (ENABLED, other)[turn % 2], number, 0), (ENABLED, number, 0))
    rig.monitor.forgive()
    rig.check((ENABLED, 0, 0), (ENABLED, 0, 0))
    with pytest.raises(DriveFault, match=f"node 2.*bit {bit}") as stopped:
        rig.checks(*(((ENABLED, number, 0), (word, number, 0)) for number in range(rig.bits_in_a_row)))
    assert stopped.value.code == word


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_a_drive_whose_profile_says_so_may_warn_by_bit_11_and_by_an_emergency(pacing: str) -> None:
    warning = '\n[[emcy]]\ncode = 0x3283\ntext = "mains voltage low"\nadvice = "check the supply"\nwarning = true\n'
    text = GENERIC.text.replace("[state_machine]", "[state_machine]\nignored_status = 0x0800") + warning
    rig = Rig(pacing, parse_profile(text, "warns.toml"))
    for number in range(3 * rig.bits_in_a_row):
        rig.emcy.on_frame(0x82, b"\x83\x32\x01\x00\x00\x00\x00\x00", 0.0)
        rig.check((ENABLED, number, 0), (ENABLED | 1 << 11, number, 0))
    rig.emcy.on_frame(0x82, b"\x10\x32\x01\x00\x00\x00\x00\x00", 0.0)
    with pytest.raises(DriveFault, match="0x3210"):
        rig.check((ENABLED, 0, 0), (ENABLED | 1 << 11, 0, 0))


def test_a_drive_that_never_shows_remote_control_goes_on(rig: Rig) -> None:
    for number in range(3 * rig.bits_in_a_row):
        rig.check((ENABLED & ~REMOTE, number, 0), (ENABLED, number, 0))


FOLLOWS = ENABLED | 1 << 12


def test_a_drive_that_no_longer_follows_its_target_is_a_reason_to_stop(rig: Rig) -> None:
    for number in range(10):
        rig.check((ENABLED if number % 2 else FOLLOWS, number, 0), (FOLLOWS, number, 0))
    with pytest.raises(DriveFault, match=r"node 2.*does not follow its target \(statusword bit 12") as stopped:
        rig.checks(*(((FOLLOWS, number, 0), (ENABLED, number, 0)) for number in range(rig.bits_in_a_row)))
    assert stopped.value.code == ENABLED


def test_a_drive_that_never_shows_bit_12_is_not_expected_to(rig: Rig) -> None:
    rig.checks(*(((ENABLED, number, 0), (ENABLED, number, 0)) for number in range(20)))
    rig.check((FOLLOWS, 20, 0), (FOLLOWS, 20, 0))
    rig.monitor.forgive()
    rig.checks(*(((ENABLED, number, 0), (ENABLED, number, 0)) for number in range(20)))


def test_a_warning_is_no_reason_to_stop(rig: Rig) -> None:
    for number in range(10):
        rig.check((ENABLED | 1 << 7, number, 0), (ENABLED, number, 0))


@pytest.mark.parametrize("data", [b"\x10\x32\x05\x00\x00\x00\x00\x00", b"\x10\x32", b"\x01", b""])
def test_an_emergency_stops_however_short_it_is(rig: Rig, data: bytes) -> None:
    rig.emcy.on_frame(0x82, data, 0.0)
    with pytest.raises(DriveFault, match="node 2.*emergency"):
        rig.check((ENABLED, 0, 0), (ENABLED, 0, 0))


def test_a_storm_of_emergencies_is_one_short_error(rig: Rig) -> None:
    for _ in range(1000):
        rig.emcy.on_frame(0x82, b"\x10\x32\x05\x00\x00\x00\x00\x00", 0.0)
    with pytest.raises(DriveFault) as stopped:
        rig.check((ENABLED, 0, 0), (ENABLED, 0, 0))
    assert len(str(stopped.value)) < 300


def test_an_emergency_that_says_all_is_well_and_an_old_one_do_not_stop(rig: Rig) -> None:
    rig.emcy.on_frame(0x82, b"\x10\x32\x05\x00\x00\x00\x00\x00", 0.0)
    rig.monitor.forgive()
    rig.emcy.on_frame(0x82, bytes(8), 0.0)
    rig.check((ENABLED, 0, 0), (ENABLED, 0, 0))


def test_an_axis_at_rest_is_read_by_sdo_and_accepted(rig: Rig) -> None:
    for _ in range(4 * SAME_IN_A_ROW + 2):
        rig.check((ENABLED, 1000, 10), (ENABLED, 2000, 20))
    assert rig.asked == 4 * 2 * 2


def test_an_answer_that_stays_while_the_axis_moves_stops(rig: Rig) -> None:
    rig.truth[1] = (2400, 20)
    with pytest.raises(DriveFault, match=r"node 2.*repeats position 2000.*SDO reports position 2400"):
        rig.checks(*(((ENABLED, number, 0), (ENABLED, 2000, 20)) for number in range(LATEST)))


def test_a_torque_that_stays_at_rest_stops_when_sdo_keeps_contradicting(rig: Rig) -> None:
    rig.truth[0] = (1000, 11)
    others = [None if number % 2 else (ENABLED, number, 20) for number in range(SAME_IN_A_ROW + LATEST)]
    with pytest.raises(DriveFault, match="node 1.*torque 10.*torque 11"):
        rig.checks(*(((ENABLED, 1000, 10), other) for other in others))


def test_a_torque_that_differs_once_at_rest_is_noise(rig: Rig) -> None:
    """Between the answer to SYNC and the question by SDO some milliseconds pass; who contradicts twice is wrong."""
    rig.truth[0] = (1000, 11)
    still = [((ENABLED, 1000, 10), (ENABLED, number, 20)) for number in range(LATEST)]
    rig.checks(*still)
    rig.truth[0] = (1000, 10)
    rig.checks(*still, *still)


@pytest.mark.parametrize(("off", "stops"), [(0.0019, False), (0.0021, True)])
def test_an_axis_at_rest_may_stand_a_little_elsewhere_by_sdo(rig: Rig, off: float, stops: bool) -> None:
    rig.truth[1] = (2000 - round(off * 65536) - (1 if stops else 0), 20)
    rows = [((ENABLED, number, 0), (ENABLED, 2000, 20)) for number in range(3 * SAME_IN_A_ROW)]
    with pytest.raises(DriveFault) if stops else contextlib.nullcontext():
        rig.checks(*rows)


def test_an_axis_that_begins_to_move_is_accepted(rig: Rig) -> None:
    rig.truth[1] = (2400, 20)
    rig.checks(*(((ENABLED, number, 0), (ENABLED, 2000, 20)) for number in range(SAME_IN_A_ROW + 2)))
    rig.checks(*(((ENABLED, number, 0), (ENABLED, 2000 + 9 * number, 20)) for number in range(1, LATEST)))


def test_a_drive_that_never_confirms_stops(rig: Rig) -> None:
    rig.deaf = True
    with pytest.raises(DriveFault, match="node 2.*does not confirm it by SDO"):
        rig.checks(*(((ENABLED, number, 0), (ENABLED, 2000, 20)) for number in range(LATEST)))
