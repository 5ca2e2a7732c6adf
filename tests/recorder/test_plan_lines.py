"""Which line of a call stack decides."""

from __future__ import annotations

import pytest

from recorder.plan_lines import deciding, passes_on

PLAN = """\
def do(**slots):
    slots = sorted(slots)
    return perform(MotionDesignator(slots))
def run(what, *rest):
    return what(*rest)
def take(thing, arm):
    perform(pick_up(object=thing, arm=arm))
def park(what):
    perform(what, "park")
do(type="moving", target=HOME)
run(do)
"""


@pytest.mark.parametrize(
    ("number", "passes"), [(2, True), (3, True), (5, True), (7, False), (9, False), (10, False), (11, False)]
)
def test_a_line_that_only_passes_unnamed_parameters_on_does_not_decide(number: int, passes: bool) -> None:
    assert passes_on(PLAN, number) is passes


def test_the_first_line_that_does_more_decides() -> None:
    stack = [("plan.py", 3), ("plan.py", 5), ("plan.py", 11)]
    assert deciding(stack, lambda _: PLAN) == 2
    assert deciding(stack[:2], lambda _: PLAN) == 0
