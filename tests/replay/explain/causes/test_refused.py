"""Refusals that a plan caught, and what lacked for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from replay.explain import causes as kinds
from tests.replay.explain.causes.explaining import line_of, words

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.explain.why import Why


def refusals(why: Why) -> list[kinds.RefusedRequest]:
    return [cause for cause in why.causes if isinstance(cause, kinds.RefusedRequest)]


@pytest.mark.parametrize("done", ["", "milk.set_position([1, 0.5, 0.1])"])
def test_a_refusal_counts_until_the_same_is_done_after_all(
    explained: Callable[..., Why], tmp_path: Path, done: str
) -> None:
    why = explained(f"""
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        try:
            milk.set_position([1, float("nan"), 0.1])
        except UsageError:
            pass
        world.simulate(0.1)
        {done}
        with span("motion", "take", {{"object": milk}}):
            raise PlanFailure("milk isn't at [1, 0, 0.1]")
    """)
    if done:
        assert not refusals(why)
        return
    (refused,) = refusals(why)
    assert (refused.precondition, refused.subject) == ("moved", "milk")
    assert refused.line.number == line_of(tmp_path, "nan")
    assert not [*refused.trials(why.case)]  # no fork puts the milk at NaN
    assert refused.went_on.number == line_of(tmp_path, "simulate")
    assert refused.asked.seq in refused.steps


def test_a_refusal_about_another_object_is_no_cause(explained: Callable[..., Why]) -> None:
    why = explained("""
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        cup = Object("cup", "cup", "cup.stl", [1, 0, 0.1])
        try:
            cup.set_position([1, 2])
        except UsageError:
            pass
        with span("motion", "take", {"object": milk}):
            raise PlanFailure("milk isn't there")
    """)
    assert not refusals(why)


def test_a_refusal_in_a_handler_names_the_event(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        from pycram.event import Event
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        def bring(who):
            try:
                milk.set_position("here")
            except UsageError:
                pass
        bell = Event("bell", "door")
        bell += bring
        bell.fire("guest")
        with span("motion", "take", {"object": milk}):
            raise PlanFailure("milk isn't there")
    """)
    (refused,) = refusals(why)
    assert refused.handler.name == "__main__.bring"
    assert refused.handler.cause in refused.steps
    assert f"the handler __main__.bring of event bell of step {refused.handler.cause}" in words(tmp_path, capsys)


def test_a_wait_in_vain_tells_what_was_refused_where_it_should_have_been_fulfilled(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        from pycram.failures import UsageError
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        full = Fluent(None, "full")
        def fill():
            try:
                milk.set_position([1, 2])
            except UsageError:
                return
            full.set_value(True)
        with timeout(0.3):
            par(full.wait_for, fill)
    """)
    (cause,) = why.causes
    ((fulfiller,),) = (pending.fulfillers for pending in cause.pending)
    assert fulfiller.refused.name == "set_position"
    assert fulfiller.refused.seq in cause.steps
    assert f"was refused at step {fulfiller.refused.seq}: BadArgument" in words(tmp_path, capsys)


def test_a_refusal_in_another_world_or_before_a_removal_is_no_cause(explained: Callable[..., Why]) -> None:
    why = explained("""
        from contextlib import suppress
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        other = BulletWorld(name="other")
        with suppress(UsageError):
            Object("milk", "milk", "milk.stl", world=other).set_position([1, 2])
        with suppress(UsageError):
            milk.set_position([1, 2])
        milk.remove()
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1], world=world)
        with span("motion", "take", {"object": milk}):
            raise PlanFailure("milk isn't there")
    """)
    assert not refusals(why)
