"""An explanation as text: what went wrong in a few sentences, then one section for each further question."""

from __future__ import annotations

import builtins
import math
import shlex
from typing import TYPE_CHECKING, Final

from recorder.records import format_failure
from recorder.records.choices import chosen_name, decision_text, rejection_lines
from replay.cli import diff, why_causes, why_tried
from replay.cli.why_advice import asked_again, commands
from replay.explain.causes.cause import Interrupted
from replay.explain.causes.why_data import heading
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.records import Failure
    from recorder.tasks import Node
    from replay.explain.causes.cause import Cause
    from replay.explain.causes.why_data import Attempt, ChangesSince, FailedBranch, InvolvedBody, Why
    from replay.history.source import Line

_FIRST, _LAST = 2, 5  # attempts that are listed one by one
_MAX_ROWS: Final = 3  # of local variables
_WIDTH: Final = 100  # characters of such a row
_MAX_LINES: Final = 12  # of a difference


def lines(why: Why, path: str) -> Iterator[str]:
    """Yield the explanation as text; ``path`` is the recording's, for commands."""
    yield from _headline(why)
    yield from _section("Unfinished when the recording ended", _unfinished(why.unfinished))
    yield from _section("Without an end: it may be among the records that are lost", _unfinished(why.endless))
    if why.failure is None:
        yield from _section("Why", _causes(why.causes))
        return
    yield from _section("Why" if len(why.causes) < 2 else "Why: the causes that are on record", _causes(why.causes))
    yield from _section("Where in the plan", _where(why))
    yield from _section("What failed", _failed(why))
    if why.tried is not None:
        yield from _section(f"What {_call(why.tried.action)} tried", why_tried.lines(why.tried))
    yield from _section(f"State{_in_world(why)} at step {why.step}", _bodies(why))
    for branch in why.branches:
        yield from _section(
            f"Also failed: {_call(branch.task.motion)}, at step {branch.task.last_step}", _branch(branch)
        )
    yield from _section("Attempts", _attempts(why))
    yield from _section("Queries that the plan relied on", _queries(why))
    yield from _section("Changes since the last success", _changes(why))
    yield from _section("Look closer", commands(why, shlex.quote(path)))


def _section(title: str, body: Iterator[str]) -> Iterator[str]:
    text = list(body)
    if text:
        yield ""
        yield title
        yield from (f"  {line}" for line in text)


def _causes(causes: Sequence[Cause]) -> Iterator[str]:
    for cause in causes:
        yield from why_causes.lines(cause)


def _branch(branch: FailedBranch) -> Iterator[str]:
    error = phrases.one_line(branch.task.error[1] or branch.task.error[0]) if branch.task.error else ""
    yield error + (f", at {phrases.path(branch.line.file)}:{branch.line.number}" if branch.line is not None else "")
    yield from _causes(branch.causes)
    for involved in branch.bodies:
        yield from _involved(involved)


def _headline(why: Why) -> Iterator[str]:
    run, name = why.run, why.run.plan or "the plan"
    interrupted = next((cause for cause in why.causes if isinstance(cause, Interrupted)), None)
    if interrupted is not None and interrupted.by:
        yield f"{name} was {why_causes.first_line(interrupted)}, after {run.seconds:.1f} s."
        return
    if run.outcome == "failed":
        message = run.failure
        if why.exceptions and why.failure is not None and _is_self_explanatory(why.failure):
            message = why.failure.message
        yield f"{name} failed after {run.seconds:.1f} s: {phrases.one_line(message)}"
    elif run.outcome == "succeeded":
        yield f"{name} succeeded{_though(why)}"
    elif run.outcome == "interrupted":
        yield f"{name} was interrupted after {run.seconds:.1f} s."
    elif run.outcome == "lost":
        yield f"How {name} ended is lost; the last step that can be read is {run.records - 1}."
    else:
        ended = "is still running" if run.outcome == "running" else f"was cut off at step {run.records - 1}"
        yield f"{name} {ended}." + ("" if why.failure else " Until then nothing failed.")
    if why.task is not None:
        yield from _summary(why, why.task)
    warning = why.warning
    if warning is not None and not why.is_python_error:
        yield f"The plan had been warned: {asked_again(warning)} was answered no at step {warning.seq}."


def _though(why: Why) -> str:
    if why.thread and why.failure is not None:
        return f", although its thread {why.thread} failed: {phrases.one_line(format_failure(why.failure))}"
    return ", although a task failed." if why.failure is not None else "."


def _is_self_explanatory(failure: Failure) -> bool:
    """Return whether a message needs no type before it; messages of Python's own errors do."""
    return " " in failure.message and not hasattr(builtins, failure.type)


def _summary(why: Why, task: Node) -> Iterator[str]:
    motion = task.motion
    error = phrases.one_line(task.error[1] or task.error[0]) if task.error else ""
    if len(why.attempts) > 1:
        name, times = motion.name, f"{'at least ' if why.forgotten else ''}{len(why.attempts)}"
        if why.since_same_success is None:
            yield f"{name} was attempted {times} times and failed each time."
        else:
            yield f"{name} failed {times} times; it last succeeded at step {why.since_same_success.task.last_step}."
        yield f"The last attempt, {_call(motion)}, failed at step {task.last_step}: {error}"
        return
    lead = "The cause:" if why.exceptions else "Before that,"
    yield f"{lead} {_call(motion)} failed at step {task.last_step}: {error}"


def _call(task: Node) -> str:
    return phrases.task(task.kind, task.name, task.parameters)


def _unfinished(tasks: Sequence[Node]) -> Iterator[str]:
    for task in tasks:
        yield " in ".join(_call(each) for each in task.around()) + f"  [since step {task.started.seq}]"


def _where(why: Why) -> Iterator[str]:
    shown: set[tuple[str, int]] = set()
    for line in () if _exceptions_lead_to_task(why) else why.call_stack:
        shown.add((line.file, line.number))
        yield from _line(line, why)
    for error in why.exceptions:
        fresh = [line for line in error.lines if (line.file, line.number) not in shown]
        if shown and fresh:
            yield f"which became {error.type}:"
        for line in fresh:
            shown.add((line.file, line.number))
            yield from _line(line, why)


def _exceptions_lead_to_task(why: Why) -> bool:
    """Return whether the lines of the exceptions lead to the task; those of a failed block end where the block does."""
    lines = [line for error in why.exceptions for line in error.lines]
    return any(
        line.file == call_site.file and call_site.function in ("", line.function)
        for call_site in why.call_stack[-1:]
        for line in lines
    )


def _line(line: Line, why: Why) -> Iterator[str]:
    yield f"{phrases.path(line.file)}:{line.number}" + (f" in {line.function}" if line.function else "")
    if line.text:
        yield f"    {line.text}"
    rows = [""]
    for name, value in why.variables.get((line.file, line.number), {}).items():
        if rows[-1] and len(rows[-1]) + len(name) + len(value) > _WIDTH:
            rows.append("")
        rows[-1] += f"{', ' if rows[-1] else ''}{name}={phrases.one_line(value)}"
    yield from (f"    with {row}" for row in rows[:_MAX_ROWS] if row)
    if len(rows) > _MAX_ROWS:
        yield "    and others, which `why --json` has"


def _failed(why: Why) -> Iterator[str]:
    yield from _tasks(why)
    for record in why.failed_threads:
        failure = phrases.one_line(format_failure(record.failure))
        yield f"also failed: thread {record.thread}, at step {record.seq}: {failure}"


def _tasks(why: Why) -> Iterator[str]:
    if why.task is None:
        if why.failure is not None:
            yield f"no task: the plan's own code raised{f', in thread {why.thread}' if why.thread else ''}"
            yield from (f"  {line}" for line in format_failure(why.failure).splitlines())
        return
    path = list(why.task.around())
    path.reverse()
    for depth, task in enumerate(path):
        if task.finished is None and task is not why.task:
            state = "not finished"
        else:
            took = phrases.seconds(task.finished.duration_ns) if task.finished is not None else ""
            state = f"failed after {took}" if task.failed else f"went on, {took}"
        yield f"{'  ' * depth}{_call(task)}  [steps {task.started.seq}-{task.last_step}, {state}]"
        if task is why.task.motion and task.decision is not None:
            yield f"{'  ' * depth}    {decision_text(task.decision, full=True)}"
    for choice in why.choices[-_LAST:]:
        yield f"{'  ' * len(path)}{phrases.question(choice)}: {chosen_name(choice) or 'none'}  [step {choice.seq}]"
        yield from (f"{'  ' * len(path)}    {line}" for line in rejection_lines(choice))
    if why.task.failure is not None:
        yield from (f"{'  ' * len(path)}{line}" for line in format_failure(why.task.failure).splitlines())
    attempted = {attempt.task for attempt in why.attempts}  # in a section of their own
    siblings = [
        part
        for part in why.task.outermost_failed.children
        if part.failed and part not in path and part.origin not in attempted
    ]
    for part in siblings[:_LAST]:
        yield f"also failed: {_call(part)}: {phrases.one_line(part.error[1]) if part.error else ''}"


def _in_world(why: Why) -> str:
    """Return which world it is, unless it is the default one."""
    world = why.world
    return f" in {world.title}" if world is not None and not (why.is_default and world.lifetime == 1) else ""


def _bodies(why: Why) -> Iterator[str]:
    for involved in why.bodies:
        yield from _involved(involved)
    yield from (f"{name} had been removed" for name in why.removed)


def _involved(involved: InvolvedBody) -> Iterator[str]:
    """Yield a body; of a fixed one its named links and joints, as where its base is tells nothing."""
    body = involved.body
    if involved.is_robot or not body.fixed_base or not (involved.links or involved.joints):
        yield _body(involved)
    for name, (position, _) in involved.links.items():
        yield f"{name} of {body.name} at {phrases.vector(position)}"
    for name, value in involved.joints.items():
        yield f"joint {name} of {body.name} at {phrases.number(value)}"


def _body(involved: InvolvedBody) -> str:
    body = involved.body
    text = f"{body.name} at {phrases.vector(body.position)}"
    if involved.is_robot:
        text += f", facing {_degrees(heading(body))}"
        text += f", holding {phrases.names([_gripped(held.body, involved) for held in involved.holds])}"
    elif involved.distance is not None and involved.bearing is not None:
        side = math.degrees(involved.bearing)
        turn = (
            "straight ahead" if abs(side) < 1 else f"{abs(side):.0f} degrees to the {'left' if side > 0 else 'right'}"
        )
        text += f", {involved.distance:.2f} m from the robot on the ground, {turn}"
    return text + (f", held by {_holder(involved)}" if involved.held else "")


def _gripped(name: str, involved: InvolvedBody) -> str:
    return f"{name} in the {involved.hands[name]} gripper" if name in involved.hands else name


def _holder(involved: InvolvedBody) -> str:
    if involved.held is None:
        return ""
    hand = involved.hands.get(involved.body.name)
    return f"the {hand} gripper of {involved.held.carrier}" if hand else phrases.carrier(involved.held)


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle)) or 0} degrees"


def _attempts(why: Why) -> Iterator[str]:
    if why.other_failures:
        tasks = "tasks" if why.other_failures > 1 else "task"
        yield f"{why.other_failures} other {tasks} failed before (see `pycram-replay tree`)"
    if why.forgotten:
        yield f"{why.forgotten} earlier failures aren't looked at here: there are too many"
    if len(why.attempts) < 2:
        return
    *earlier, last = (attempt.task.motion.parameters for attempt in why.attempts)
    varying = [key for key in last if any(parameters.get(key) != last[key] for parameters in earlier)]
    poses = [_robot_pose(attempt) for attempt in why.attempts]
    differ = len({pose for pose in poses if pose}) > 1
    groups: list[tuple[str, str, list[int]]] = []  # parameters, error and steps of equal attempts in a row
    for attempt, pose in zip(why.attempts, poses, strict=True):
        how = [f"{key}={phrases.value(attempt.task.motion.parameters.get(key))}" for key in varying]
        how += [pose] if pose and differ else []
        error = phrases.one_line(attempt.task.error[1]) if attempt.task.error else ""
        if not groups or groups[-1][:2] != (", ".join(how), error):
            groups.append((", ".join(how), error, []))
        groups[-1][2].append(attempt.task.motion.started.seq)
    left_out = len(groups) - _FIRST - _LAST
    for number, (parameters, error, steps) in enumerate(groups):
        if left_out > 1 and number == _FIRST:
            yield f"... {left_out} more ..."
        if left_out <= 1 or not _FIRST <= number < _FIRST + left_out:
            many = f"steps {steps[0]} to {steps[-1]}, {len(steps)} times" if len(steps) > 1 else f"step {steps[0]}"
            yield f"{many}: {parameters}" if parameters else f"{many}:"
            yield f"    {error}"


def _robot_pose(attempt: Attempt) -> str:
    robot = attempt.robot
    return f"{robot.name} at {phrases.vector(robot.position[:2])} facing {_degrees(heading(robot))}" if robot else ""


def _queries(why: Why) -> Iterator[str]:
    if why.earlier_queries:
        yield f"... {why.earlier_queries} earlier ones ..."
    for relevant in why.queries:
        query = relevant.query
        reasons = phrases.reasons(query)
        yield f"step {query.seq}: {phrases.question(query)}"
        yield f"    {phrases.answer(query)}" + (f": {reasons}" if reasons else "")
        if relevant.world:
            yield f"    asked in another world: {relevant.world}"
        if relevant.moved:
            yield f"    since then {phrases.names(relevant.moved)} moved"
        if relevant.removed:
            were = "was" if len(relevant.removed) == 1 else "were"
            yield f"    since then {phrases.names(relevant.removed)} {were} removed"


def _changes(why: Why) -> Iterator[str]:
    if why.task is not None:
        motion = why.task.motion
        if why.since_same_success is None:
            yield f"No {phrases.task(motion.kind, motion.name, {})} succeeded before."
        else:
            yield from _since(why.since_same_success)
    if why.since_last_success is not None and (
        why.since_same_success is None or why.since_same_success.task is not why.since_last_success.task
    ):
        yield from _since(why.since_last_success)


def _since(since: ChangesSince) -> Iterator[str]:
    task = since.task
    changes = list(diff.lines(since.difference)) if since.difference.notable or since.difference.added else []
    name = f"{_call(task)} succeeded at step {task.last_step}"
    if not changes:
        yield f"{name}; since then nothing in the world has changed."
        return
    yield f"{name}; since then:"
    yield from (f"  {line}" for line in changes[:_MAX_LINES])
    if len(changes) > _MAX_LINES:
        yield f"  ... {len(changes) - _MAX_LINES} more lines; `diff` lists all"
