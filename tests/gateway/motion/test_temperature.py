"""Temperatures are asked for one drive at a time, and no answer is waited for."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np

from drives.profile import Temperature
from drives.sdo import Posted
from gateway.motion.temperature import MotorTemperatures

TENTHS = Temperature.model_validate(
    {
        "object": {"index": 0x2A00, "subindex": 1, "type": "i16"},
        "unit_c": {"value": 0.1, "source": "test"},
        "of": "motor",
    }
)


@dataclass
class Client:
    """An SDO client whose questions are answered by hand."""

    asked: list[Posted] = field(default_factory=list)
    timeout_s: float = 100.0

    def post(self, index: int, subindex: int, data_type: str) -> Posted:
        assert (index, subindex, data_type) == (0x2A00, 1, "i16")
        self.asked.append(Posted(data_type, time.monotonic() + self.timeout_s))
        return self.asked[-1]


def answer(posted: Posted, value: int | None) -> None:
    posted.answered, posted.value = True, value


def test_each_drive_is_asked_once_a_visit_one_after_the_other():
    first, second = Client(), Client()
    read = MotorTemperatures([(first, TENTHS), None, (second, TENTHS)])
    read.poll()
    read.poll()
    assert (len(first.asked), len(second.asked)) == (1, 0)
    answer(first.asked[0], 415)
    read.poll()
    answer(second.asked[0], -52)
    for _ in range(5):
        read.poll()
    assert (len(first.asked), len(second.asked)) == (1, 1)
    assert np.array_equal(read.read_c, [41.5, math.nan, -5.2], equal_nan=True)
    read.begin()
    assert np.isnan(read.read_c).all()
    read.poll()
    assert len(first.asked) == 2


def test_a_refusal_or_a_lost_answer_leaves_nan_and_the_next_drive_is_asked():
    refusing, unanswered, answering = Client(), Client(timeout_s=0.0), Client()
    read = MotorTemperatures([(refusing, TENTHS), (unanswered, TENTHS), (answering, TENTHS)])
    read.poll()
    answer(refusing.asked[0], None)
    read.poll()
    read.poll()
    answer(answering.asked[0], 300)
    read.poll()
    assert np.array_equal(read.read_c, [math.nan, math.nan, 30.0], equal_nan=True)
