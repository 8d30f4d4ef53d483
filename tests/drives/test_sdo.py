"""SDO transfers, and every case in which an answer may be delayed, foreign or wrong (CiA 301, 7.2.4.3)."""

from __future__ import annotations

import contextlib
import struct
import threading
import time

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drives.abort import ABORT_CODES
from drives.bus import Bus, BusSpec, open_bus
from drives.datasheet.object_values import decoded, size_bytes
from drives.errors import DriveError, SdoAbort, SdoError, SdoProtocolError, SdoTimeout
from drives.sdo import ONCE, SLOW, SdoClient


@pytest.fixture
def slave(make_slave):
    return make_slave(3)


@pytest.fixture
def sdo(bus, slave):
    client = SdoClient(bus, 3, timeout_s=0.3, slow_timeout_s=2.0)
    yield client
    client.close()


def delayed_once(delay_s):
    """The first answer comes with delay, all others in time."""
    delays = iter([delay_s])
    return lambda request, answer: [(next(delays, 0.001), answer)]


def test_expedited_values_of_every_length(sdo, slave):
    assert sdo.read(0x1018, 1, "u32") == 0x1234
    assert sdo.read(0x6060, 0, "i8") == 0
    sdo.write(0x6060, 0, "i8", -3)
    assert sdo.read(0x6060, 0, "i8") == -3
    sdo.write(0x607A, 0, "i32", -123456)
    assert slave.values[0x607A, 0] == -123456


@pytest.mark.parametrize("length", [1, 6, 7, 8, 13, 14, 15, 300])
def test_segmented_upload(sdo, slave, length):
    slave.texts[0x1008, 0] = bytes(65 + number % 26 for number in range(length))
    assert sdo.upload(0x1008) == slave.texts[0x1008, 0]


def test_a_name_in_a_drive_is_text_without_control_characters(sdo, slave):
    slave.texts[0x1008, 0] = b"drive\x1b]0;owned\x07\x9b2Jend\r\n\0"
    assert sdo.read_text(0x1008) == "drive ]0;owned  2Jend"


@pytest.mark.parametrize("length", [0, 5, 7, 8, 14, 15, 50])
def test_segmented_download(sdo, slave, length):
    data = bytes(range(length))
    sdo.download(0x1008, 0, data)
    assert slave.downloaded == data


def test_abort_in_words_with_node_object_and_remedy(sdo, slave):
    slave.refused[0x6077, 0] = 0x06020000
    with pytest.raises(SdoAbort, match=r"node 3:6077:00 \(torque\).*0x06020000.*does not exist.*profile") as caught:
        sdo.read(0x6077, 0, "i16")
    assert (caught.value.node, caught.value.index, caught.value.code) == (3, 0x6077, 0x06020000)
    assert caught.value.exit_code == 4


def test_every_abort_code_of_the_library_is_known_here():
    from canopen.sdo import SdoAbortedError

    assert set(SdoAbortedError.CODES) <= set(ABORT_CODES)


def test_a_delayed_answer_is_never_the_answer_to_the_next_question(sdo, slave):
    """The answer to 0x6064 comes after its time-out: the next read is of another object."""
    slave.reply = delayed_once(0.35)
    slave.position, slave.torque = 111, 222
    with pytest.raises(SdoTimeout):
        sdo.upload(0x6064, 0, ONCE)
    assert sdo.read(0x6077, 0, "i16") == 222
    slave.wire.sleep(1.0)
    assert sdo.read(0x6064, 0, "i32") == 111
    assert sdo.statistics.late == 1


def test_a_delayed_answer_is_not_taken_for_a_fresh_one_of_the_same_object(sdo, slave):
    slave.reply = delayed_once(0.35)
    slave.position = 111
    with pytest.raises(SdoTimeout):
        sdo.upload(0x6064, 0, ONCE)
    slave.position = 999
    assert sdo.read(0x6064, 0, "i32") == 999


def test_a_repeated_read_waits_until_the_first_answer_has_arrived(sdo, slave):
    """The read is repeated by itself; the delayed answer holds what the object was at the first request."""
    values = iter([111, 999])
    delays = iter([0.35, 0.001])

    def reply(request, answer):
        return [(next(delays), answer[:4] + struct.pack("<i", next(values)))]

    slave.reply = reply
    assert sdo.read(0x6064, 0, "i32") == 999
    assert (sdo.statistics.timeouts, sdo.statistics.late) == (1, 1)


def test_a_delayed_abort_does_not_hit_another_object(sdo, slave):
    slave.refused[0x2010, 0] = 0x06020000
    slave.reply = delayed_once(0.35)
    with pytest.raises(SdoTimeout):
        sdo.upload(0x2010, 0, ONCE)
    slave.wire.sleep(0.045)
    assert sdo.read(0x6077, 0, "i16") == slave.torque


def test_a_write_is_sent_once_whatever_happens(sdo, slave):
    slave.reply = lambda request, answer: []
    with pytest.raises(SdoTimeout):
        sdo.write(0x6060, 0, "i8", 8)
    assert slave.written == [(0x6060, 0, 8)]


def test_a_delayed_confirmation_does_not_confirm_the_next_write(sdo, slave):
    slave.reply = delayed_once(0.35)
    with pytest.raises(SdoTimeout):
        sdo.write(0x6060, 0, "i8", 8)
    start = slave.wire.now_s
    slave.reply = lambda request, answer: [] if request[0] & 0xE0 == 0x20 else [(0.001, answer)]
    with pytest.raises(SdoTimeout):
        sdo.write(0x6060, 0, "i8", 9)
    assert slave.wire.now_s - start >= 0.3


@pytest.mark.parametrize("wrong", [b"\x60\x41\x60\x00", b"\x60\x60\x60\x01", b"\x43\x60\x60\x00"])
def test_a_download_is_confirmed_only_by_its_own_object(sdo, slave, wrong):
    slave.reply = lambda request, answer: [(0.001, wrong + bytes(4))]
    with pytest.raises(SdoProtocolError, match="6060:00"):
        sdo.write(0x6060, 0, "i8", 8)


@pytest.mark.parametrize("wrong", [b"\x43\x77\x60\x00", b"\x43\x64\x60\x01", b"\x60\x64\x60\x00"])
def test_an_upload_is_answered_only_by_its_own_object(sdo, slave, wrong):
    slave.reply = lambda request, answer: [(0.001, wrong + bytes(4)), (0.002, answer)]
    slave.position = 77
    assert sdo.read(0x6064, 0, "i32") == 77
    slave.reply = lambda request, answer: [(0.001, wrong + bytes(4))]
    with pytest.raises(SdoProtocolError, match="none of them to this request"):
        sdo.read(0x6064, 0, "i32", ONCE)


def test_an_abort_for_another_object_is_not_ours(sdo, slave):
    abort = b"\x80\x10\x20\x00\x00\x00\x02\x06"
    slave.reply = lambda request, answer: [(0.001, abort), (0.002, answer)]
    assert sdo.read(0x6077, 0, "i16") == slave.torque


def test_a_wrong_toggle_bit_ends_the_transfer(sdo, slave, wire):
    def reply(request, answer):
        wrong = bytes([answer[0] ^ 0x10]) + answer[1:]
        return [(0.001, wrong if request[0] == 0x70 else answer)]

    slave.reply = reply
    with pytest.raises(SdoProtocolError, match="toggle"):
        sdo.upload(0x1008)
    assert wire.sent[-1] == (0x603, b"\x80\x08\x10\x00" + struct.pack("<I", 0x05030000))


@pytest.mark.parametrize("announced", [3, 25, 1 << 20])
def test_a_wrong_length_is_refused(sdo, slave, announced):
    def reply(request, answer):
        return [(0.001, answer[:4] + struct.pack("<I", announced) if answer[0] == 0x41 else answer)]

    slave.reply = reply
    with pytest.raises(SdoProtocolError):
        sdo.upload(0x1008)


def test_a_drive_that_sends_without_end_is_stopped(sdo, slave):
    def reply(request, answer):
        if answer[0] == 0x41:
            return [(0.0, b"\x40" + answer[1:4] + bytes(4))]
        return [(0.0, bytes([request[0] & 0x10]) + bytes(7))]

    slave.reply = reply
    with pytest.raises(SdoProtocolError):
        sdo.upload(0x1008)


def test_a_duplicated_answer_does_not_answer_the_next_question(sdo, slave):
    slave.reply = lambda request, answer: [(0.001, answer), (0.001, answer)]
    for value in (5, 6, 7, 8):
        slave.position = value
        assert sdo.read(0x6064, 0, "i32") == value


def test_a_short_answer_is_no_answer(sdo, slave):
    slave.reply = lambda request, answer: [(0.001, answer[:6])]
    with pytest.raises(SdoProtocolError):
        sdo.read(0x6064, 0, "i32", ONCE)


@pytest.mark.parametrize(
    ("data", "kind", "value"),
    [
        (b"\xfe\xff\xff\xff", "i16", -2),
        (b"\x05\x00\x00\x00", "i16", 5),
        (b"\xff\x00\x00\x00", "u8", 255),
        (b"\xfe\xff\x00\x00", "i16", -2),
        (b"\x80\x00\x00\x00", "i8", -128),
    ],
)
def test_an_answer_that_is_longer_than_its_type_is_read_by_its_value(sdo, slave, data, kind, value):
    slave.reply = lambda request, answer: [(0.0, b"\x43" + request[1:4] + data)]
    assert sdo.read(0x6077, 0, kind) == value


@pytest.mark.parametrize(("data", "kind"), [(b"\x00\x00\x01\x00", "i16"), (b"\xff\xff\xff\xff", "u16")])
def test_an_answer_that_does_not_fit_its_type_is_refused(sdo, slave, data, kind):
    slave.reply = lambda request, answer: [(0.0, b"\x43" + request[1:4] + data)]
    with pytest.raises(SdoProtocolError, match=kind):
        sdo.read(0x6077, 0, kind)
    slave.reply = lambda request, answer: [(0.0, b"\x4f" + request[1:4] + b"\x01\x00\x00\x00")]
    with pytest.raises(SdoProtocolError, match="1 bytes"):
        sdo.read(0x6077, 0, "i16")


@pytest.mark.parametrize("command", [0x42, 0x46, 0x4E])
def test_a_size_that_is_not_indicated_is_none(sdo, slave, command):
    """CiA 301, 7.2.4.3.6: n is valid only if e = 1 and s = 1; without s four bytes of data came."""
    slave.reply = lambda request, answer: [(0.0, bytes([command]) + request[1:4] + b"\x01\x02\x03\x04")]
    assert sdo.upload(0x2000) == b"\x01\x02\x03\x04"


def test_an_object_of_unknown_length_is_read_to_its_end(sdo, slave):
    def reply(request, answer):
        return [(0.001, b"\x40" + answer[1:4] + bytes(4) if answer[0] == 0x41 else answer)]

    slave.reply = reply
    assert sdo.upload(0x1008) == slave.texts[0x1008, 0]


@pytest.mark.parametrize(("announced", "asked_on"), [(1 << 16, True), ((1 << 16) + 1, False)])
def test_an_object_that_is_too_long_is_refused_before_it_is_sent(sdo, slave, wire, announced, asked_on):
    def reply(request, answer):
        return [(0.001, answer[:4] + struct.pack("<I", announced) if answer[0] == 0x41 else answer)]

    slave.reply = reply
    with pytest.raises(SdoProtocolError, match=f"{announced}"):
        sdo.upload(0x1008)
    assert any(data[0] == 0x60 for can_id, data in wire.sent if can_id == 0x603) == asked_on


def test_a_wrong_toggle_bit_of_a_confirmation_ends_a_download(sdo, slave):
    def reply(request, answer):
        return [(0.001, bytes([answer[0] ^ 0x10]) + answer[1:] if request[0] & 0xE0 == 0 else answer)]

    slave.reply = reply
    with pytest.raises(SdoProtocolError, match="toggle"):
        sdo.download(0x1008, 0, bytes(20))
    assert len(slave.downloaded) == 7


def test_slow_objects_have_their_own_time(sdo, slave):
    slave.reply = lambda request, answer: [(1.5, answer)]
    assert sdo.upload(0x1000, 0, SLOW) == b"\x92\x01\x02\x00"


def test_a_transfer_from_a_frame_handler_is_refused_at_once(bus, sdo, wire):
    caught = []

    def handler(can_id, data, time_s):
        try:
            sdo.upload(0x1000)
        except DriveError as error:
            caught.append(str(error))

    bus.subscribe(0x123, handler)
    wire.emit(0x123, b"")
    bus.drain()
    assert len(caught) == 1
    assert "only store the frame" in caught[0]


def test_a_question_is_open_until_its_own_answer_comes(bus, sdo, slave):
    delays = iter([0.05, 0.3])
    slave.reply = lambda request, answer: [(next(delays, 0.001), answer)]
    first = sdo.ask()
    slave.wire.sleep(0.01)
    second = sdo.ask()
    bus.listen(0.1)
    assert (first.answered, second.answered) == (True, False)
    bus.listen(0.3)
    assert second.answered
    assert sdo.statistics.late == sdo.statistics.foreign == 0
    slave.refused[0x1001, 0] = 0x06020000
    third = sdo.ask()
    bus.listen(0.01)
    assert third.answered


def test_latency_histogram_counts_every_answer(sdo, slave):
    for delay_s in (0.0001, 0.003, 0.003, 0.04):
        slave.reply = lambda request, answer, delay_s=delay_s: [(delay_s, answer)]
        sdo.upload(0x1000)
    statistics = sdo.statistics
    assert statistics.count == sum(statistics.histogram) == 4
    assert statistics.max_s == pytest.approx(0.04, rel=0.01)
    assert statistics.mean_s == pytest.approx((0.0001 + 0.003 + 0.003 + 0.04) / 4, rel=0.02)
    assert statistics.histogram[4] == 2


def test_two_threads_on_one_node_take_turns_and_get_their_own_answers():
    """The server waits a little before it answers: is it asked again meanwhile?"""
    stop = threading.Event()
    server = can.Bus(interface="virtual", channel="sdo-threads")
    overlaps: list[int] = []
    wrong: list[int] = []

    def serve():
        while not stop.is_set():
            request = server.recv(0.02)
            while request is not None and request.arbitration_id == 0x603:
                following = server.recv(0.001)
                if following is not None:
                    overlaps.append(following.arbitration_id)
                data = bytes(request.data)
                answer = b"\x43" + data[1:4] + data[1:3] + b"\0\0"
                server.send(can.Message(arbitration_id=0x583, data=answer, is_extended_id=False))
                request = following

    def read(index):
        wrong.extend(1 for _ in range(60) if sdo.read(index, 0, "u32") != index)

    threads = [threading.Thread(target=serve)]
    with open_bus(BusSpec("virtual", "sdo-threads")) as bus:
        sdo = SdoClient(bus, 3, timeout_s=5.0)
        threads += [threading.Thread(target=read, args=(index,)) for index in (0x2001, 0x2002)]
        for thread in threads:
            thread.start()
        for thread in threads[1:]:
            thread.join()
        stop.set()
        threads[0].join()
    server.shutdown()
    assert (wrong, overlaps) == ([], [])
    assert sdo.statistics.count == 120


class Chatter:
    """An adapter that answers every request with the next frames of a list."""

    def __init__(self, frames):
        self.frames, self.queue = list(frames), []

    def send(self, message):
        self.queue += [self.frames.pop(0)] if self.frames else []

    def recv(self, timeout=None):
        if self.queue:
            return can.Message(arbitration_id=0x583, data=self.queue.pop(0), is_extended_id=False)
        Chatter.now += (timeout or 0.0) + 1e-6
        return None

    def shutdown(self):
        self.queue.clear()

    now = 0.0


frames = st.lists(st.binary(max_size=8), max_size=12)
likely = st.lists(
    st.builds(
        lambda command, address, rest: bytes([command]) + address + rest,
        st.sampled_from([0x40, 0x41, 0x43, 0x4B, 0x4F, 0x00, 0x10, 0x01, 0x11, 0x60, 0x20, 0x30, 0x80, 0xC0]),
        st.sampled_from([b"\x08\x10\x00", b"\0\0\0", b"\x09\x10\x00"]),
        st.binary(min_size=4, max_size=4),
    ),
    max_size=12,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(frames, likely), st.booleans())
def test_whatever_comes_is_a_value_or_a_typed_error(monkeypatch, answers, upload):
    monkeypatch.setattr(time, "monotonic", lambda: Chatter.now)
    with Bus(Chatter(answers), BusSpec("test", "chatter")) as bus:
        sdo = SdoClient(bus, 3, timeout_s=0.1, slow_timeout_s=0.2)
        with contextlib.suppress(SdoError):
            if upload:
                assert isinstance(sdo.upload(0x1008), bytes)
            else:
                sdo.download(0x1008, 0, bytes(9))


def test_a_posted_read_takes_its_answer_when_it_comes(bus, sdo, slave):
    slave.reply = lambda request, answer: [(0.02, answer)]
    posted = sdo.post(0x1018, 1, "u32")
    refused = sdo.post(0x5FFF, 0, "u16")
    assert posted.value is None
    assert not posted.answered
    bus.listen(0.1)
    assert (posted.value, posted.answered) == (0x1234, True)
    assert (refused.value, refused.answered) == (None, True)
    assert sdo.read(0x1018, 1, "u32") == 0x1234
    assert sdo.statistics.late == sdo.statistics.foreign == 0


@pytest.mark.parametrize(
    ("command", "data", "kind", "value"),
    [
        (0x42, b"\xfe\xff\xaa\xaa", "i16", -2),
        (0x42, b"\x08\xaa\xaa\xaa", "u8", 8),
        (0x4E, b"\x34\x12\xff\xff", "u16", 0x1234),
        (0x42, b"\x01\x02\x03\x04", "u32", 0x04030201),
        (0x43, b"\xfe\xff\x00\x00", "i16", -2),
    ],
)
def test_one_value_by_every_method_of_reading(bus, sdo, slave, command, data, kind, value):
    """CiA 301, 7.2.4.3.6: without an indicated size the bytes behind the object are undefined."""
    code = {"u8": 0x05, "i16": 0x03, "u16": 0x06, "u32": 0x07}[kind]
    slave.reply = lambda request, answer: [(0.001, bytes([command]) + request[1:4] + data)]
    posted = sdo.post(0x6077, 0, kind)
    bus.listen(0.01)
    assert posted.value == value
    assert sdo.read(0x6077, 0, kind) == value
    assert decoded(code, sdo.upload(0x6077, 0, size_bytes=size_bytes(code))) == value


def test_a_lost_answer_does_not_shift_those_that_follow(bus, sdo, slave):
    """Asked every 0.1 s, the third answer is lost: each later value is the one of its own question."""
    asked = 0

    def reply(request, answer):
        nonlocal asked
        asked += 1
        return [] if asked == 3 else [(0.001, answer)]

    slave.reply = reply
    seen = []
    for torque in range(20):
        slave.torque = torque
        posted = sdo.post(0x6077, 0, "i16")
        bus.listen(0.1)
        seen.append(posted.value)
    missing = [torque for torque, value in enumerate(seen) if value is None]
    assert missing == [2, 3, 4]
    assert [value for value in seen if value is not None] == [0, 1, *range(5, 20)]


def test_one_question_at_a_time_for_one_object(bus, sdo, slave, wire):
    slave.reply = lambda request, answer: [(0.05, answer)]
    first = sdo.post(0x6077, 0, "i16")
    assert sdo.post(0x6077, 0, "i16") is first
    other = sdo.post(0x6064, 0, "i32")
    assert [can_id for can_id, _ in wire.sent] == [0x603, 0x603]
    bus.listen(0.1)
    assert (first.value, other.value) == (slave.torque, slave.position)


def test_a_possibly_delayed_answer_is_as_old_as_the_first_question_that_it_may_answer(bus, sdo, slave, wire):
    delays = iter([0.4])
    slave.reply = lambda request, answer: [(next(delays, 0.001), answer)]
    slave.torque, requested_s = 1, wire.now_s
    sdo.post(0x6077, 0, "i16")
    bus.listen(0.35)
    slave.torque = 2
    second = sdo.post(0x6077, 0, "i16")
    bus.listen(0.1)
    assert second.answered
    assert second.requested_s - requested_s < 0.001
    bus.listen(2.0)
    last_s = wire.now_s
    last = sdo.post(0x6077, 0, "i16")
    bus.listen(0.1)
    assert (last.value, last.requested_s >= last_s) == (2, True)


def test_a_lost_answer_to_the_question_whether_a_node_is_there_does_not_keep_later_ones_open(bus, sdo, slave):
    lost = iter([[]])
    slave.reply = lambda request, answer: next(lost, [(0.001, answer)])
    for number in range(8):
        question = sdo.ask()
        bus.listen(0.05)
        assert question.answered == (number != 0)
