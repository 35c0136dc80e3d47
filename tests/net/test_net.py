"""The net under every change: what the commands say of twelve dives is what they said.

A change that means to move numbers stores them anew, `make net`, and its commit shows which.
"""

import net
import pytest

# What takes longest, and has tests of its own beside these.
NIGHTLY = ("propose", "calibrate", "observability")
CASES = [
    pytest.param(case, marks=pytest.mark.nightly) if case in NIGHTLY else case
    for case in net.CASES
]


@pytest.mark.all_starts
@pytest.mark.parametrize("case", CASES)
def test_commands_say_what_they_said(case: str) -> None:
    if case in net.RECORDED and not net.SHARED.is_dir():
        pytest.skip("needs ../shared/data (real dives)")
    changed = net.moved(
        net.stored_lines(case), net.lines_of(case), net.LEAST_OF.get(case, net.LEAST)
    )
    assert not changed, "\n".join([f"{len(changed)} lines have moved, the first:", *changed[:20]])


@pytest.mark.parametrize(
    ("was", "now", "same"),
    [
        ("rmse\t1.25", "rmse\t1.2500000001", True),
        ("rmse\t1.25", "rmse\t1.25000001", False),
        ("samples\t300", "samples\t301", False),
        ("word\twhite", "word\tcorrelated", False),
        ("rmse\tnan", "rmse\t0.1", False),
        ("rmse\t1.25", "rmse\t1.25\t1.0", False),
        ("nis\t[1.0, 2.5]", "nis\t[1.0, 2.5000000001]", True),
        ("nis\t[1.0, 2.5]", "nis\t[1.0, 2.6]", False),
        ("nis\t[1.0, 2.5]", "nis\t[1.0, 2.5, 3.0]", False),
    ],
)
def test_words_and_counts_are_held_exactly_and_numbers_in_nine_digits(
    was: str, now: str, same: bool
) -> None:
    assert (net.moved([was], [now]) == []) == same
