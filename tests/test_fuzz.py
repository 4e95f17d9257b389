"""Damaged inputs and words that are off end in one sentence (`fuzz.py`): some hundred of them here, ten thousand by `make fuzz`."""

import os

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fuzz import Program

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="the cases run in forked processes")]


@pytest.fixture(scope="module")
def program():
    program = Program()
    yield program
    program.close()


@settings(
    max_examples=300,
    derandomize=True,
    database=None,
    deadline=None,
    phases=[Phase.generate, Phase.shrink],
    suppress_health_check=list(HealthCheck),
)
@given(chance=st.randoms(use_true_random=False))
def test_whatever_comes_it_ends_in_a_sentence(program, chance):
    fault = program.fault_of(chance)
    assert not fault, str(fault)
