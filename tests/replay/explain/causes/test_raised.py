"""What a plan raised itself, and its mistakes: the line, and what came before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.designator import DesignatorError
from pycram.exploration import NotExplorable
from pycram.failures import UsageError
from pycram.fluent import NotSettable
from pycram.foundation.plugins import PluginFailed
from pycram.language import timeout
from pycram.motions.process_module import NoDescription
from pycram.projection import NotProjectable
from pycram.sweeping import SweepRefused
from replay.explain import causes as kinds
from replay.explain.causes.raised import USAGE_ERRORS
from tests.replay.explain.causes.explaining import WITH_PR2, line_of, words

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from replay.explain.why import Why


def test_a_raise_in_a_branch_is_the_plan_s_own_line(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained("""
        apple = Object("apple", "apple", "apple.stl", [0, 0, 0.04])
        def check(body):
            if btr.contact(body, body.world.get_object("floor")):
                raise PlanFailure(f"{body.name} lies on the floor")
        with par as s:
            s(check, apple)
    """)
    (cause,) = (cause for cause in why.causes if isinstance(cause, kinds.Raised))
    assert cause.own
    assert cause.line.number == line_of(tmp_path, "raise PlanFailure")
    assert cause.task.name == "check"
    assert [answer.name for answer in cause.answers] == ["contact"]
    assert [involved.body.name for involved in why.bodies] == ["apple"]


@pytest.mark.parametrize("succeeds", [False, True])
def test_a_raise_after_a_failed_motion_names_that(explained: Callable[..., Why], succeeds: bool) -> None:
    why = explained(f"""
        {WITH_PR2}
        def took():
            try:
                perform(type="pick-up", object=milk, arm="left")
            except PlanFailure:
                return False
        gone = not took()
        if {succeeds}:
            perform(type="moving", target=[1, 1, 0])
        if gone:
            raise PlanFailure("no milk for you")
    """)
    (cause,) = why.causes
    assert isinstance(cause, kinds.Raised)
    assert [answer.name for answer in cause.answers] == ([] if succeeds else ["pick-up"])
    assert set(cause.steps) >= {answer.seq for answer in cause.answers}


def test_a_mistake_of_the_plan_s_is_its_line_and_not_a_raise(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained("""
        apple = Object("apple", "apple", "apple.stl", [0, 0, 0.04])
        def lift(body):
            body.set_position([0, 0])
        lift(apple)
    """)
    (cause,) = why.causes
    assert not cause.own
    assert cause.type == "BadArgument"
    assert cause.line.number == line_of(tmp_path, "set_position([0, 0])")


def test_a_mistake_rests_on_its_refusal(explained: Callable[..., Why]) -> None:
    why = explained("""
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        milk.set_position([1, 2])
    """)
    (raised,) = why.causes
    with_refusal = [step for step in raised.steps if step != why.step]
    assert with_refusal


def test_all_of_pycram_s_usage_errors_are_known_as_mistakes() -> None:
    def below(kind: type) -> Iterator[str]:
        for each in kind.__subclasses__():
            if each.__module__.startswith("pycram."):
                yield each.__name__
                yield from below(each)

    assert {
        DesignatorError,
        NoDescription,
        NotExplorable,
        NotProjectable,
        NotSettable,
        PluginFailed,
        SweepRefused,
    } <= set(UsageError.__subclasses__())
    assert timeout  # the words of the plan language are loaded, with what they refuse
    assert {*below(UsageError), "UsageError"} == USAGE_ERRORS


@pytest.mark.parametrize(
    ("handling", "own"), [("raise ValueError('no dinner') from failure", True), ("print(failure.thing)", False)]
)
def test_what_the_plan_made_of_a_failure_is_told_beside_its_cause(
    explained: Callable[..., Why], tmp_path: Path, handling: str, own: bool
) -> None:
    why = explained(f"""
        {WITH_PR2}
        try:
            perform(type="pick-up", object=milk, arm="left")
        except PlanFailure as failure:
            {handling}
    """)
    raised = next(each for each in why.causes if isinstance(each, kinds.Raised))
    assert (raised.own, raised.line.number) == (own, line_of(tmp_path, handling))
    assert [answer.name for answer in raised.answers] == ["pick-up"]
    assert any(isinstance(each, kinds.UnreachedTarget) for each in why.causes)


def test_what_whenever_reacted_to_is_told_with_the_line_that_changed_it(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        from pycram.fluent import whenever
        from pycram.language import pursue
        level = Fluent(3, "level")
        def inspect():
            if level.get_value() < 2:
                raise PlanFailure("it runs dry")
        def drink():
            level.set_value(1)
            Fluent(None, "refilled").wait_for()
        with pursue as s:
            s(whenever, level.pulsed(), inspect)
            s(drink)
    """)
    raised = next(each for each in why.causes if isinstance(each, kinds.Raised))
    assert [answer.name for answer in raised.answers] == ["level"]
    assert f"level became 1, at plan.py:{line_of(tmp_path, 'level.set_value')}" in words(tmp_path, capsys).replace(
        f"{tmp_path}/", ""
    )


@pytest.mark.parametrize("statement", ["things[0]", "dict(things)['a']", "next(iter(things))"])
def test_a_list_that_a_failure_left_empty_leads_to_it(explained: Callable[..., Why], statement: str) -> None:
    why = explained(f"""
        {WITH_PR2}
        things = []
        try:
            things.append(perform(type="detecting", object_type="cup"))
        except PlanFailure:
            pass
        print({statement})
    """)
    swallowed = next(each for each in why.causes if isinstance(each, kinds.Swallowed))
    assert (swallowed.subject, swallowed.failed.name) == ("things", "detecting")


def test_of_several_things_that_were_not_found_the_one_that_is_missed_is_told(explained: Callable[..., Why]) -> None:
    why = explained(f"""
        {WITH_PR2}
        known = {{}}
        for kind in ("cup", "bowl"):
            try:
                known[kind] = perform(type="detecting", object_type=kind)
            except PlanFailure:
                pass
        print(known["cup"])
    """)
    swallowed = next(each for each in why.causes if isinstance(each, kinds.Swallowed))
    assert swallowed.failed.parameters["object-type"] == "cup"
    assert swallowed.went_on == swallowed.line


def test_the_line_that_gives_the_values_comes_before_the_helper_that_passes_them_on(
    explained: Callable[..., Why], tmp_path: Path
) -> None:
    why = explained(f"""
        {WITH_PR2}
        perform(type="pick-up", object=milk, arm="middle")
    """)
    (raised,) = why.causes
    assert raised.line.number == line_of(tmp_path, 'arm="middle"')
