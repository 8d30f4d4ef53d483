"""A result as the commands write it, as a dictionary."""

import copy

import pytest

from tests.support.pages.result import full_result as build


@pytest.fixture(scope="session")
def full_result():
    return build()


@pytest.fixture
def result(full_result):
    return copy.deepcopy(full_result)
