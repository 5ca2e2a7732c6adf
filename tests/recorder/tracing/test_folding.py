"""Tracebacks that ``pycram run`` prints: frames of the plan, with PyCRAM's frames folded."""

from __future__ import annotations

import itertools
import re
from typing import NoReturn

import pytest

from pycram.failures import PlanFailure
from pycram.foundation.errors import PycramError, raise_unchanged
from pycram.language import failure_handling, par
from recorder.tracing.folding import format_folded

FRAME = re.compile(r'  File ".*test_folding\.py", line \d+, in (\w+)')


def failing(error: BaseException) -> NoReturn:
    raise_unchanged(error)  # a frame of PyCRAM's own


def retried() -> None:
    numbers = itertools.count()
    for attempt in failure_handling(7):
        with attempt:
            failing(PlanFailure(f"attempt {next(numbers)}"))


def in_parallel() -> None:
    par(lambda: failing(PlanFailure("one")), lambda: failing(PlanFailure("other")))


def internal() -> None:
    failing(ZeroDivisionError("a bug"))


def folded(raising: object) -> list[str]:
    with pytest.raises(Exception) as raised:  # noqa: PT011
        raising()  # type: ignore[operator]
    text = format_folded(raised.value, PycramError)
    return [FRAME.sub(r"  in \1", line) for line in text.splitlines() if not line.startswith("    ")]


def test_earlier_attempts_at_the_same_line_are_a_line_each() -> None:
    assert folded(retried) == [
        "Failed before, at the same line of the plan:",
        "  ... 2 more",
        *(f"  pycram.failures.PlanFailure: attempt {number}" for number in range(2, 7)),
        "",
        "Traceback (most recent call last):",
        "  in folded",
        "  in retried",
        "  in failing",
        "  ... 1 frame inside pycram ...",
        "pycram.failures.PlanFailure: attempt 7",
    ]


def test_failures_of_branches_are_folded_within_the_message() -> None:
    text = folded(in_parallel)
    for message in ("one", "other"):
        end = text.index(f"  | pycram.failures.PlanFailure: {message}")
        assert text[end - 1] == "  |   ... 1 frame inside pycram ..."
    assert not any("/pycram/" in line for line in text)
    assert text[-1] == "pycram.failures.BranchesFailed: par failed: PlanFailure: one; PlanFailure: other"


def test_an_error_that_may_be_a_bug_of_pycram_keeps_its_innermost_frames() -> None:
    *_, caller, inner, message = folded(internal)
    assert caller == "  in failing"
    assert "errors.py" in inner
    assert message == "ZeroDivisionError: a bug"


def test_a_mistake_in_the_plan_s_syntax_has_no_frames_of_the_runner() -> None:
    with pytest.raises(SyntaxError) as raised:
        compile("print(1", "plan.py", "exec")
    raised.value.__traceback__ = None
    assert format_folded(raised.value, PycramError).splitlines()[0] == '  File "plan.py", line 1'
