"""What has ended is freed at once: a plan that runs for days leaves nothing for the garbage collector to find."""

from __future__ import annotations

import gc
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram.language import failure_handling, finally_, par, pursue, seq, timeout, try_all, try_in_order

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def nothing() -> None:
    pass


def each() -> None:
    for kind in (seq, par, pursue, try_all, try_in_order):
        with kind as block:
            block(nothing)
            block(nothing)


def nested() -> None:
    with par, seq as inner:
        inner(nothing)
        inner(nothing)
    with try_in_order, par as inner:
        inner(nothing)
    with seq, pursue as inner:
        inner(nothing)


def functions() -> None:
    par(nothing, nothing)
    try_all(nothing, nothing)


def around() -> None:
    with timeout(60), finally_(nothing):
        for attempt in failure_handling(1):
            with attempt:
                nothing()


@pytest.mark.slow
@pytest.mark.parametrize("plan", [each, nested, functions, around])
@pytest.mark.parametrize("recorded", [False, True])
def test_what_has_ended_is_freed_at_once(plan: Callable[[], None], tmp_path: Path, *, recorded: bool) -> None:
    if recorded:
        with recorder.record(tmp_path / "x.mcap"):
            left = left_by(plan)
    else:
        left = left_by(plan)
    assert left == 0


def left_by(plan: Callable[[], None]) -> int:
    """How many objects only the garbage collector can free after a plan has run."""
    plan()  # what comes to be once
    gc.collect()
    gc.disable()
    try:
        plan()
        return gc.collect()
    finally:
        gc.enable()
