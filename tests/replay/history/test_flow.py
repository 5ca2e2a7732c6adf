"""Lines that flow into a line, by the source alone."""

from __future__ import annotations

from textwrap import dedent

from replay.history.flow import Flow

PLAN = dedent("""\
    DEPTH = 30 / 1000
    UNUSED = 7
    held = {}
    def free():
        if held:
            return None
        return next(arm for arm in ARMS if arm not in held)
    def take(thing, depth=DEPTH):
        held[thing] = 5
        arm = free()
        perform(pick_up(object=thing, arm=arm))
    take("cup")
    """)


def test_lines_are_followed_through_names_containers_and_returns() -> None:
    lines = Flow(PLAN).lines({11: 0.0, 12: 0.5}, failed=11)
    assert {*lines[:3]} == {5, 6, 7}  # lines that compute come before the failed call, which passes values on
    assert {3, 5, 7, 9, 10, 12} < {*lines}


def test_a_failed_line_with_numbers_of_its_own_comes_first() -> None:
    assert Flow("x = f(2)\ng(x, 8)\n").lines({2: 0.0}, failed=2) == [2, 1]
    assert Flow("g(x, 8").lines({1: 0.0}) == []
