"""``check``: properties of a recording, with the task and the line of the plan that violated them."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from recorder import html
from recorder.properties import Property, PropertyVerdict
from recorder.properties.expressions import RANGE, Geometry
from recorder.properties.language import AT_END
from recorder.properties.monitor import FOLLOWED, NEVER_HELD, CheckedMoment, Monitor
from recorder.records import Record, Task
from replay.explain.blame_report import because
from replay.history.tasks import CausingTasks, causing_tasks
from replay.report import phrases, report

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

_UNITS: Final = {"m": phrases.length, "rad": phrases.degrees, "s": "{:.3f} s".format, "m/s": "{:.3f} m/s".format}


@dataclass(frozen=True, slots=True, repr=False)
class CheckedProperty:
    """The result of a property for a recording."""

    path: str  # path of the recording
    verdict: PropertyVerdict
    record: Record | None = None  # record of the first violation
    causes: CausingTasks | None = None  # tasks and lines of the plan that led to the violation

    def __bool__(self) -> bool:
        return self.verdict.holds

    def __repr__(self) -> str:
        return f"<{next(lines(self))}>"

    def _repr_html_(self) -> str:
        headline, *more = lines(self)
        return html.page(headline, html.text(more))


def check(log: RecordReader, properties: Sequence[Property], geometry: Geometry | None = None) -> list[CheckedProperty]:
    """Check properties in a single pass over a recording.

    Raises:
        BadProperty: A property has no value at any step, for example because of an unknown name.
    """
    monitor = Monitor(properties, geometry)
    for record in log.records(FOLLOWED):
        monitor.feed(record)
    monitor.finish()
    found = []
    for verdict in monitor.verdicts():
        cause = None if verdict.holds else _cause(log, verdict)
        causes = None if cause is None else causing_tasks(log, cause)
        found.append(CheckedProperty(str(log.path), verdict, cause, causes))
    return found


def _cause(log: RecordReader, verdict: PropertyVerdict) -> Record | None:
    """Return the record of the first violation.

    For "at end", this is the record after which the condition never holds again. If a condition never held, this is the
    end of the last failed task, preferably of one with an object of the property; None if no task failed.
    """
    first = verdict.violations[0]
    at_end = verdict.statement.kind == AT_END
    moment = first.since if at_end else first.moment
    if first.cause != NEVER_HELD and moment is not None:
        return log[moment.step]
    start = first.since.step if first.since else 0
    names = verdict.statement.body.names
    about: set[int] = set()  # the tasks that have an object of the property
    failed: list[Task] = []
    for task in log.records(Task):
        if task.phase == Task.STARTED and any(re.search(rf"\b{re.escape(name)}\b", str(task)) for name in names):
            about.add(task.task)
        if task.status == Task.FAILED and start <= task.seq:
            failed.append(task)
    known = (each for each in failed if not at_end or each.task in about)
    return max(known, key=lambda each: (each.task in about, each.seq), default=None)


@report.data.register(CheckedProperty)
def _(checked: CheckedProperty) -> dict[str, object]:
    verdict = checked.verdict
    found: dict[str, object] = {
        "property": verdict.statement.text,
        "source": verdict.statement.source,
        "holds": verdict.holds,
        "margin": verdict.margin if math.isfinite(verdict.margin) else None,
        "unit": verdict.statement.body.unit,
        "closest": _moment_data(verdict.closest),
        "values": verdict.values,
        "episodes": verdict.episodes,
        "note": verdict.note,
        "blamed_step": None if checked.record is None else checked.record.seq,
        "violations": [
            {**_moment_data(each.moment), "margin": each.margin if math.isfinite(each.margin) else None}
            | {"values": each.values, "cause": each.cause}
            for each in verdict.violations
        ],
    }
    return found | {"causes": report.data(checked.causes), "commands": list(commands(checked))}


def _moment_data(moment: CheckedMoment | None) -> dict[str, object]:
    if moment is None:
        return {}
    return {"step": moment.step, "sim_seconds": moment.seconds, "world": moment.world}


def lines(checked: CheckedProperty) -> Iterator[str]:
    """Yield the result as text; for a violation, also its cause, and commands that show details."""
    verdict = checked.verdict
    if verdict.holds:
        yield f"holds     {verdict.statement}{_how_close(verdict)}"
        return
    first = verdict.violations[0]
    times = f", {len(verdict.violations)} times" if len(verdict.violations) > 1 else ""
    yield f"violated  {verdict.statement}"
    by = f", by {_amount(verdict.margin, verdict)}" if math.isfinite(verdict.margin) else ""
    if by and not first.cause and verdict.closest is not None and verdict.closest.time != first.moment.time:
        by += f" at worst, at {verdict.closest.seconds:.3f} s"
    yield f"  at step {first.moment.step} ({first.moment.seconds:.3f} s){by}{times}{first.cause and f': {first.cause}'}"
    yield from (f"  {text} = {_value(value)}" for text, value in first.values.items())
    if by and first.cause and verdict.closest is not None and verdict.closest.step != first.moment.step:
        yield f"  closest at step {verdict.closest.step}"
    if checked.record is not None and checked.causes is not None:
        yield f"  step {checked.record.seq}: {phrases.record_line(checked.record)}"
        yield from because(checked.causes, "  ", [])
    else:
        yield f"  it never held, and {'no task failed' if first.cause == NEVER_HELD else 'nothing changed its value'}"
    yield from (f"  {command}" for command in commands(checked))


def commands(checked: CheckedProperty) -> Iterator[str]:
    """Yield commands that show details of the first violation."""
    if not checked.verdict.violations:
        return
    log, step = shlex.quote(checked.path), step_of(checked)
    yield f"pycram-replay view {log} --at {step}"
    yield f"pycram-replay state {log} {step}"


def step_of(checked: CheckedProperty) -> str:
    """Return the step of the first violation in the form that verbs accept, or its time within a simulation."""
    moment = checked.verdict.violations[0].moment
    return f"{moment.seconds:.4f}s" if moment.sampled else str(moment.step)


def _how_close(verdict: PropertyVerdict) -> str:
    if verdict.note:
        return f": nothing to check, {verdict.note}"
    if verdict.closest is None or not math.isfinite(verdict.margin):
        return ""
    values = ", ".join(f"{text} = {_value(value)}" for text, value in verdict.values.items())
    return f"\n  by {_amount(verdict.margin, verdict)}, closest at step {verdict.closest.step}: {values}"


def _amount(margin: float, verdict: PropertyVerdict) -> str:
    text = _UNITS.get(verdict.statement.body.unit, phrases.number)(abs(margin))
    return f"{text} or more" if verdict.statement.body.needs_geometry and abs(margin) >= RANGE else text


def _value(value: Any) -> str:
    return "None" if value is None else phrases.value(list(value) if isinstance(value, tuple) else value)
