"""Failure handling: number of retries, their failures, and their parameters."""

# ruff: noqa: PT012, PT031  the blocks under test have bodies
from __future__ import annotations

import traceback
from typing import TYPE_CHECKING

import pytest

from pycram import tasks
from pycram.failures import BadArgument, InCollision, LookingFailed, PlanFailure, Unreachable, UsageError
from pycram.language import failure_handling, par, pursue, retry
from pycram.language.retries import FailureLeft
from tests.pycram.language.gates import C, F, Gate, S, fails, fails_to_look, is_wrong, succeeds

if TYPE_CHECKING:
    from collections.abc import Callable


def test_five_retries_are_six_runs_and_then_the_last_failure_with_the_earlier_ones() -> None:
    runs = []

    def run() -> None:
        runs.append(1)
        raise Unreachable("left", [len(runs), 0, 0])

    with pytest.raises(Unreachable) as raised:
        for attempt in failure_handling(5):
            with attempt:
                run()
    assert len(runs) == 6
    assert raised.value.target[0] == 6
    text = "".join(traceback.format_exception(raised.value))
    assert all(f"[{number}.000" in text for number in range(1, 7))
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert [part.attempt for part in node.attempts] == [1, 2, 3, 4, 5, 6]
    assert {part.status for part in node.attempts} == {F}
    assert [part.failure.type for part in node.attempts] == ["Unreachable"] * 6
    assert node.status is F


def test_retry_works_as_in_cram() -> None:
    seen = []
    for attempt in failure_handling(5, arm="left"):
        with attempt:
            try:
                seen.append((attempt.number, attempt["arm"]))
                if attempt["arm"] == "left":
                    fails()
            except Unreachable:
                retry(arm="right")
    assert seen == [(1, "left"), (2, "right")]
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert [part.status for part in node.attempts] == [F, S]
    assert [part.parameters for part in node.attempts] == [{"arm": "left"}, {"arm": "right"}]
    runs = []
    with pytest.raises(Unreachable):
        for attempt in failure_handling(2):
            with attempt:
                runs.append(1)
                try:
                    fails()
                except Unreachable:
                    retry()
    assert len(runs) == 3
    with pytest.raises(PlanFailure, match="all 1 retries"):
        for attempt in failure_handling(1):
            with attempt:
                retry()
    with pytest.raises(UsageError, match="in the body of"):
        retry()


def test_retry_in_a_branch_reaches_its_attempt() -> None:
    runs = []

    def branch() -> None:
        runs.append(1)
        if len(runs) < 3:
            retry()

    for attempt in failure_handling(5):
        with attempt, par as s:
            s(branch)
            s(succeeds)
    assert len(runs) == 3


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt, SystemExit])
def test_a_retry_in_one_branch_does_not_hide_a_bug_or_ctrl_c_in_another(error: type[BaseException]) -> None:
    runs, started = [], Gate()

    def tries_again() -> None:
        started.pass_through()
        retry()

    def breaks_off() -> None:
        started.open()
        raise error

    with pytest.raises(error):
        for attempt in failure_handling(5):
            with attempt:
                runs.append(1)
                par(tries_again, breaks_off)
    assert len(runs) == 1


def test_recoveries_by_the_type_of_failure() -> None:
    recovered = []

    def step_back(failure: InCollision) -> None:
        recovered.append(failure.bodies)

    def other_arm(failure: Unreachable) -> dict[str, object]:
        return {"arm": {"left": "right"}[failure.arm]}

    handling = failure_handling(3).on(Unreachable, other_arm).on(InCollision, step_back)

    def act(arm: str = "left") -> str:
        if not recovered:
            raise InCollision([0, 0, 0], [0, 0, 0, 1], ["table"])
        if arm == "left":
            par(fails, fails)  # a failed block of that type is of that type
        return arm

    assert handling.run(act) == "right"
    assert recovered == [["table"]]
    recovered.clear()
    assert handling(act)() == "right"  # as a decorator, and a second time
    with pytest.raises(KeyError):  # a recovery's error is raised
        handling.run(lambda **_: (_ for _ in ()).throw(Unreachable("both", [0, 0, 0])))
    with pytest.raises(BadArgument, match="result of the recovery"):
        failure_handling(1).on(PlanFailure, lambda _: 3).run(fails)


def test_only_the_named_failures_and_never_bugs_are_retried() -> None:
    runs = []

    def run(action: Callable[[], None]) -> None:
        runs.append(1)
        action()

    with pytest.raises(LookingFailed):
        failure_handling(5, Unreachable).run(run, fails_to_look)
    with pytest.raises(BadArgument):
        failure_handling(5).run(run, is_wrong)
    with pytest.raises(BadArgument):
        for attempt in failure_handling(5):
            with attempt:
                try:
                    run(is_wrong)
                except UsageError:
                    retry()
    assert len(runs) == 3
    for wrong in (-1, True, 1.5):
        with pytest.raises(BadArgument):
            failure_handling(wrong)
    with pytest.raises(BadArgument):
        failure_handling(1, ValueError)
    with pytest.raises(BadArgument, match="recovery"):
        failure_handling(1).on(PlanFailure, {"arm": "left"})


@pytest.mark.parametrize("retries", [True, False])
def test_a_changed_parameter_must_be_one_of_the_handling(retries: bool) -> None:
    attempts = []
    with pytest.raises(BadArgument, match=r"\{'arms': 'right'\}.*only arm, place"):
        for attempt in failure_handling(2, arm="left", place=0).on(PlanFailure, lambda _: {"arms": "right"}):
            with attempt:
                attempts.append(attempt["arm"])
                if retries:
                    retry(arms="right")
                raise Unreachable("left", [0, 0, 0])
    assert attempts == ["left"]


def test_misused_failure_handlings_are_refused() -> None:
    with pytest.raises(UsageError, match="for attempt in failure_handling"), failure_handling(5):
        pass
    with pytest.raises(UsageError, match="must be `with attempt:`"):
        for _ in failure_handling(5):
            pass


def test_leaving_the_loop_after_a_failure_ends_the_handling_and_warns() -> None:
    with pytest.warns(FailureLeft, match="after attempt 2 failed: Unreachable: left arm") as warned:
        for attempt in failure_handling(5):
            with attempt:
                fails()
            if attempt.number == 2:
                break
    assert warned[0].filename == __file__
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert len(node.attempts) == 2
    assert node.status is F
    assert tasks.current() is None


def test_a_cancelled_branch_that_leaves_the_loop_causes_no_warning() -> None:
    failed = Gate()

    def between_attempts() -> None:
        for attempt in failure_handling(5):
            with attempt:
                fails()
            failed.open()
            Gate().pass_through()

    with pursue as s:
        s(between_attempts)
        s(failed.pass_through)
    assert [branch.state for branch in s.branches] == [C, S]


def test_leaving_the_loop_with_the_failure_handled_or_raised() -> None:
    for attempt in failure_handling(5):
        with attempt:
            try:
                fails()
            except Unreachable:
                break
    with pytest.raises(LookingFailed):
        for attempt in failure_handling(5, Unreachable):
            with attempt:
                fails() if attempt.number == 1 else fails_to_look()


def test_attempts_in_a_concurrent_body_see_their_failures() -> None:
    runs = []

    def run() -> None:
        runs.append(1)
        if len(runs) < 3:
            fails()

    with par as s:
        for attempt in failure_handling(5):
            with attempt:
                par(run)
        s(failure_handling(5).run, run)
    assert len(runs) == 4
