"""Which errors of a user's prediction are those of `math` outside a domain, which have no code of their own."""

import math
from collections.abc import Callable
from math import log, sqrt

import numpy as np
import pytest

from insdvl_replay.nav.user_measurement import is_of_math

TINY = -1.0


def root(value: float) -> float:
    """Take a root in a function of its own."""
    return math.sqrt(
        value,
    )


def refused() -> None:
    """Refuse as people do, with the words of `math`."""
    raise ValueError("math domain error")


def caught() -> None:
    """Find an error of `math`, and say something else."""
    try:
        math.sqrt(TINY)
    except ValueError as error:
        raise ValueError("expected a number that is not negative") from error


def of_another_shape() -> None:
    """Have numpy refuse."""
    np.zeros(2) + np.zeros(3)


OF_MATH: list[Callable[[], object]] = [
    lambda: math.sqrt(TINY),
    lambda: sqrt(TINY),
    lambda: 1.0 + 2.0 * log(TINY) * 3.0,
    lambda: math.acos(2.0),
    lambda: root(TINY),
    lambda: [math.sqrt(one) for one in (1.0, TINY)],
]
OF_OTHERS: list[Callable[[], object]] = [
    refused,
    caught,
    of_another_shape,
    lambda: int("one"),
    lambda: float("one"),
    lambda: [1].index(2),
    lambda: np.linalg.norm(np.zeros(2), axis=(0, 1, 2)),
]


def error_of(call: Callable[[], object]) -> ValueError:
    with pytest.raises(ValueError) as raised:
        call()
    return raised.value


@pytest.mark.parametrize("call", OF_MATH)
def test_a_function_of_math_outside_its_domain_is_known(call: Callable[[], object]) -> None:
    assert is_of_math(error_of(call))


@pytest.mark.parametrize("call", OF_OTHERS)
def test_other_errors_of_values_are_not_taken_for_it(call: Callable[[], object]) -> None:
    assert not is_of_math(error_of(call))


def test_an_error_that_was_not_raised_is_of_nobody() -> None:
    assert not is_of_math(ValueError("math domain error"))


def test_code_without_a_file_is_of_nobody() -> None:
    space = {"math": math}
    exec("def root():\n    return math.sqrt(-1.0)", space)
    call = space["root"]
    assert callable(call)
    assert not is_of_math(error_of(call))
