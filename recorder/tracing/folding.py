"""Tracebacks for the author of a plan: PyCRAM's own frames are left out, and each earlier attempt is one line."""

from __future__ import annotations

from itertools import groupby
from textwrap import indent
from typing import Final

from recorder import notebook
from recorder.records import tracebacks
from recorder.tracing.call_stack import is_machinery, is_plan

_BEFORE: Final = "Failed before, at the same line of the plan:\n"
_ATTEMPTS: Final = 5  # maximum number of earlier attempts that are printed


def format_folded(error: BaseException, ours: type[BaseException]) -> str:
    """Return an error and its causes as text, with the frames of the plan and of the libraries that it calls.

    Errors of other types than ``ours`` keep PyCRAM's innermost frames, because such an error may be a bug of PyCRAM.
    Causes that PyCRAM has raised and handled are left out.
    """
    token = tracebacks.formatter.set(lambda each: _formatted(each, ours))
    try:
        return notebook.with_cells(_formatted(error, ours))
    finally:
        tracebacks.formatter.reset(token)


def _formatted(error: BaseException, ours: type[BaseException]) -> str:
    parts: list[str] = []
    before: list[str] = []  # messages of the errors of earlier attempts
    shown = [
        (link, each)
        for link, each in tracebacks.chain(error)
        if each is error or not isinstance(each, ours) or each.__traceback__ is None or _plan_line(each) is not None
    ]
    for (link, each), (next_link, following) in zip(shown, [*shown[1:], ("", error)], strict=True):
        line = _plan_line(each)
        if line is not None and next_link == tracebacks.CONTEXT and line == _plan_line(following):
            before.append(indent("".join(tracebacks.message(each)), "  "))
            continue
        if before:
            left_out = len(before) - _ATTEMPTS
            more = f"  ... {left_out} more\n" if left_out > 0 else ""
            parts += [_BEFORE, more, *before[-_ATTEMPTS:], "\n"]
            before = []
        elif parts:
            parts.append(link)
        parts.append(_part(each, ours))
    return "".join(parts)


def _plan_line(error: BaseException) -> tuple[str, int] | None:
    """Return the plan's innermost line, as file and number; None if there is none."""
    entries = tracebacks.entries(error.__traceback__)
    plan = [(each.tb_frame.f_code.co_filename, each.tb_lineno) for each in entries if is_plan(each.tb_frame)]
    return plan[-1] if plan else None


def _part(error: BaseException, ours: type[BaseException]) -> str:
    """Return an error without its causes, from the plan's outermost frame on."""
    entries = tracebacks.entries(error.__traceback__)
    plan = [index for index, each in enumerate(entries) if is_plan(each.tb_frame)]
    if isinstance(error, SyntaxError) and not plan:  # an error in the plan's own source
        return "".join(tracebacks.message(error))
    if not plan or isinstance(error, BaseExceptionGroup):
        return tracebacks.part(error)
    parts = [tracebacks.TITLE]
    end = len(entries) if isinstance(error, ours) else plan[-1]
    for folded, group in groupby(
        enumerate(entries[plan[0] :], plan[0]), lambda each: each[0] < end and is_machinery(each[1].tb_frame)
    ):
        same = [entry for _, entry in group]
        count = f"  ... {len(same)} frame{'s' if len(same) > 1 else ''} inside pycram ...\n"
        parts += [count] if folded else tracebacks.stack(same)
    return "".join((*parts, *tracebacks.message(error)))
