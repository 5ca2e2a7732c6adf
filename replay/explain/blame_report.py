"""The last change of a body or a joint, as JSON data, as text and as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

from recorder import html
from recorder.records import Keyframe, argument_values
from replay.history.blame import Blame, Carried, commanded
from replay.history.source import Line
from replay.history.tasks import CausingTask, CausingTasks
from replay.report import phrases, report

if TYPE_CHECKING:
    from recorder.geometry import Pose

_MIN_TURN: Final = math.radians(0.05)  # angle below which a turn isn't mentioned


@report.data.register(Blame)
def _(change: Blame) -> dict[str, object]:
    data = report.fields_data(change, default_world="without", body="object")
    return data | {"distance": change.distance if math.isfinite(change.distance) else None}


@report.data.register(Carried)
def _(carried: Carried) -> dict[str, object]:
    held = carried.held
    found = {"carrier": held.carrier, "carrier_link": held.carrier_link, "body": held.body}
    return found | {"step": carried.step, "causes": report.data(carried.causes)}


@report.data.register(CausingTask)
def _(task: CausingTask) -> dict[str, object]:
    started = task.started
    found = {"id": started.task, "kind": started.kind, "name": started.name}
    found |= {"parameters": argument_values(started.parameters), "step": started.seq, "cause": started.cause}
    return found | report.call_stack(task.call_stack)


@report.data.register(CausingTasks)
def _(causes: CausingTasks) -> dict[str, object]:
    return {"tasks": report.data(causes.tasks)} | report.call_stack(causes.call_stack)


def lines(change: Blame) -> Iterator[str]:
    """Yield the change, its causes, and the change before it as text."""
    return _lines(change, [], set())


@html.rendered.register(Blame)
def _(change: Blame) -> str:
    headline, *more = lines(change)
    return html.page(headline, html.text(more))


def _lines(change: Blame, printed: list[Sequence[Line]], told: set[int], *, is_earlier: bool = False) -> Iterator[str]:
    yield _headline(change)
    yield f"  step {change.record.seq}: {phrases.record_line(change.record)}"
    if not getattr(change.record, "by_fork", False):  # the line of a fork's change names the fork
        yield from because(change.causes, "  ", printed, told)
    for carried in change.carried:
        yield from _held(carried, printed, told)
    if change.other_worlds and not is_earlier:
        yield f"  ({change.body} is in {phrases.names(change.other_worlds)}, too; choose a world with --world)"
    if change.default_world and not is_earlier:
        yield f"  ({change.default_world}, the last opened world, has no {change.body}; choose a world with --world)"
    if change.earlier is not None:
        yield ""
        yield "Before that:"
        yield from _lines(change.earlier, printed, told, is_earlier=True)


def _headline(change: Blame) -> str:
    name = f"{change.body}.{change.joint}" if change.joint else change.body
    name += f" in {change.world}" if change.other_worlds or change.default_world else ""
    if change.after is None:
        return f"{name} was removed" + (f" from {_value(change.before)}" if change.before is not None else "")
    where = _value(change.after)
    if isinstance(change.record, Keyframe):
        return f"{name} was already at {where} when the recording began"
    if change.how == "load":
        return f"{name} has been at {where} since its loading"
    carrier = change.carried[-1].held.carrier if change.carried else ""
    moved = phrases.change(name, change.how, commanded(change.record) if change.how == "along" else carrier)
    if isinstance(change.before, float) and isinstance(change.after, float):
        before, after = phrases.apart(change.before, change.after)
        return f"{moved}: from {before} to {after}"
    turned = phrases.turned(change.angle)
    if change.angle and not change.distance:
        size = f"{turned}, not moved away,"
    else:
        size = f"by {phrases.length(change.distance)}" + (f", {turned}," if change.angle >= _MIN_TURN else "")
    return f"{moved}: {size} to {where}"


def _value(value: Pose | float) -> str:
    return phrases.number(value) if isinstance(value, float) else phrases.vector(value[0])


def because(
    causes: CausingTasks, indent: str, printed: list[Sequence[Line]], told: set[int] | None = None
) -> Iterator[str]:
    """Yield the tasks around a record, and the plan's lines that led to the record.

    Args:
        printed: call stacks that were printed before; this call stack is added.
        told: steps at which printed tasks started. The tasks around a printed task aren't printed again.
    """
    for started in (task.started for task in causes.tasks):
        called = phrases.task(started.kind, started.name, argument_values(started.parameters))
        by = "by" if started.kind == "handler" else "in"
        event = f", step {started.cause}" if by == "by" and started.cause else ""  # 0 before the recording
        again = told is not None and started.seq in told
        yield f"{indent}{by} {called}{event}  [step {started.seq}{', as above' if again else ''}]"
        if again:
            break
        if told is not None:
            told.add(started.seq)
    if not causes.tasks:
        yield f"{indent}by the plan itself"
    yield from (f"{indent}{line}" for line in phrases.call_stack_lines(causes.call_stack, printed))


def _held(carried: Carried, printed: list[Sequence[Line]], told: set[int]) -> Iterator[str]:
    held = carried.held
    if carried.step is None or carried.causes is None:
        yield f"  {phrases.carrier(held)} already held {held.body} when the recording began"
        return
    yield f"  {phrases.carrier(held)} has held {held.body} since step {carried.step}"
    yield from because(carried.causes, "    ", printed, told)
