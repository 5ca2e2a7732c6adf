"""Tracebacks in records: as Python prints them, bounded, and each line of code is formatted only once."""

from __future__ import annotations

import re
import traceback
from typing import TYPE_CHECKING, NoReturn

import pytest

from pycram.failures import PlanFailure
from pycram.language import par, seq
from recorder.records import Task
from recorder.records.tracebacks import MAX_ERRORS, format_traceback

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.conftest import MemorySink


class Shy(Exception):
    def __str__(self) -> str:
        raise ZeroDivisionError


def recursive(depth: int) -> None:
    if not depth:
        raise ValueError("of two\nlines")
    recursive(depth - 1)


def there(depth: int) -> None:
    (back(depth - 1) if depth else {}["nowhere"])


def back(depth: int) -> None:
    there(depth - 1)


def caused() -> None:
    try:
        there(6)
    except KeyError as error:
        raise Shy from error


def in_handler() -> None:
    try:
        caused()
    except Shy:
        None.grasp  # type: ignore[attr-defined]  # noqa: B018


def of_both() -> None:
    try:
        there(2)
    except KeyError as error:
        try:
            recursive(12)
        except ValueError:
            raise TypeError from error


def from_none() -> None:
    try:
        there(2)
    except KeyError:
        raise PlanFailure("not why") from None


def noted() -> None:
    error = PlanFailure("noted")
    error.add_note("in the kitchen\nat the sink")
    error.add_note("twice")
    raise error


def from_unraised() -> None:
    raise ValueError("raised") from KeyError("never raised")


def circular() -> None:
    first, second = ValueError("first"), KeyError("second")
    first.__cause__, second.__cause__ = second, first
    raise first


def misspelt() -> None:
    compile("arm = = 'left'\n", "plan.py", "exec")


def missing() -> None:
    import recorder.nothing  # type: ignore[import-not-found]  # noqa: F401, PLC0415


def grouped() -> None:
    errors: list[Exception] = []
    for raising in (caused, in_handler, misspelt):
        try:
            raising()
        except Exception as error:  # noqa: BLE001
            errors.append(error)
    raise ExceptionGroup("several", [*errors, ExceptionGroup("some", errors[1:])])


def from_a_group() -> None:
    try:
        grouped()
    except ExceptionGroup as error:
        raise PlanFailure("of several") from error


def of_branches() -> None:
    par(from_none, lambda: par(noted, from_none))


@pytest.mark.parametrize(
    "raising",
    [
        lambda: recursive(20),
        caused,
        in_handler,
        of_both,
        from_none,
        noted,
        from_unraised,
        circular,
        misspelt,
        missing,
        grouped,
        from_a_group,
        of_branches,
    ],
)
def test_a_text_is_what_python_prints(raising: Callable[[], None]) -> None:
    with pytest.raises(Exception) as raised:  # noqa: PT011
        raising()
    for _ in range(2):  # the second time from texts that are there
        assert format_traceback(raised.value) == "".join(traceback.format_exception(raised.value))


def test_equal_code_of_two_files_is_told_apart() -> None:
    texts = []
    for file in ("first.py", "second.py"):
        with pytest.raises(ZeroDivisionError) as raised:
            exec(compile("1 / 0", file, "exec"), {})
        texts.append(format_traceback(raised.value))
    assert ['"first.py"' in text for text in texts] == [True, False]


def test_of_a_long_chain_the_first_and_last_errors_are_there_and_the_others_are_counted() -> None:
    def again(left: int) -> NoReturn:
        if not left:
            raise PlanFailure("error 0.")
        try:
            again(left - 1)
        except PlanFailure as error:
            raise PlanFailure(f"error {left}.") from error

    with pytest.raises(PlanFailure) as raised:
        again(99)
    text = format_traceback(raised.value)
    there = [int(number) for number in re.findall(r"PlanFailure: error (\d+)\.", text)]
    assert there == [0, 1, 2, 3, *range(100 - MAX_ERRORS + 4, 100)]
    assert f"[{100 - MAX_ERRORS} errors are left out; see the tasks" in text
    whole = format_traceback(raised.value, errors=100)
    assert whole == "".join(traceback.format_exception(raised.value))


def fails() -> None:
    raise PlanFailure("no")


def sequences(left: int) -> None:
    if not left:
        fails()
    with seq:
        sequences(left - 1)


def branches(left: int) -> None:
    if not left:
        fails()
    with par as s:
        s(branches, left - 1)
        s(fails)


def others(left: int) -> None:
    if not left:
        fails()
    try:
        with seq:
            others(left - 1)
    except PlanFailure as error:
        raise PlanFailure(f"level {left}") from error


def groups(left: int) -> None:
    if not left:
        fails()
    try:
        with seq:
            groups(left - 1)
    except Exception as error:
        raise ExceptionGroup(f"level {left}", [error]) from error


@pytest.mark.parametrize(("nested", "tasks"), [(sequences, 40), (branches, 120), (others, 40)])
def test_frames_are_formatted_once_however_many_blocks_an_error_comes_through(
    nested: Callable[[int], None], tasks: int, sink: MemorySink, monkeypatch: pytest.MonkeyPatch
) -> None:
    formatted = 0
    of_python = traceback.StackSummary.format_frame_summary

    def counted(self: traceback.StackSummary, *arguments: traceback.FrameSummary, **options: bool) -> str:
        nonlocal formatted
        formatted += 1
        return of_python(self, *arguments, **options)

    monkeypatch.setattr(traceback.StackSummary, "format_frame_summary", counted)
    with pytest.raises(PlanFailure):
        nested(40)
    ended = [task.failure.traceback for task in sink.of(Task) if task.phase == Task.FINISHED]
    assert len(ended) == tasks
    assert all("in fails" in text for text in ended)
    assert formatted < 40


def test_groups_in_each_other_are_formatted_as_far_as_there_are_few(
    sink: MemorySink, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_at = 0
    of_python = traceback.TracebackException.__init__

    def counted(self: traceback.TracebackException, *arguments: object, **options: object) -> None:
        nonlocal looked_at
        looked_at += 1
        of_python(self, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(traceback.TracebackException, "__init__", counted)
    with pytest.raises(ExceptionGroup):
        groups(60)
    ended = [task.failure for task in sink.of(Task) if task.phase == Task.FINISHED]
    assert all("in fails" in failure.traceback for failure in ended)
    assert "ExceptionGroup: level 59 (1 sub-exception)" in ended[-1].traceback
    assert looked_at < 60 * 64


def test_tracebacks_of_blocks_that_fail_in_each_other_take_a_bounded_place(sink: MemorySink) -> None:
    sizes = []
    for levels in (20, 60):
        before = len(sink.records)
        with pytest.raises(PlanFailure):
            branches(levels)
        sizes.append(max(record.ByteSize() for record in sink.records[before:]))
    assert sizes[1] < 1.2 * sizes[0]
