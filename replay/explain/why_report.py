"""An explanation as JSON data and as text: a summary, and a section for each aspect."""

from __future__ import annotations

import builtins
import shlex
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, zip_longest
from typing import Final

from recorder.records import Query, format_assertion, format_failure
from recorder.records.text import chosen_name, decision_text, fates_text, foreseen, rejection_lines
from recorder.tasks import Node
from replay.compare import difference_lines
from replay.explain.causes.case import Cause
from replay.explain.causes.raised import Raised
from replay.explain.causes.trials import TriedTrial
from replay.explain.causes.waiting import Interruption
from replay.explain.good_run import GoodRun
from replay.explain.why import ChangesSince, InvolvedBody, TriedAction, Why, facing
from replay.history.oddities import oddities
from replay.history.source import Line
from replay.report import phrases, report
from replay.report.question import BadQuestion, Name, QueryCall, Term, question_of
from replay.report.report import section
from replay.state.json_data import record_data

_FIRST, _LAST = 2, 5  # number of first and of last attempts that are listed
_MAX_ROWS: Final = 3  # maximum number of rows of local variables
_WIDTH: Final = 100  # maximum number of characters in a row of variables
_NO_CAUSE: Final = (
    "no cause was found; these were looked for: failures and refusals before it, moved and removed objects, "
    "wrong beliefs, full or empty hands, obstacles, distances, deadlines, other worlds and gravity"
)
_MAX_LINES: Final = 12  # maximum number of lines for a difference of states
_NEARER: Final = 0.35  # distance in m from the robot to which the suggested ``ask --move`` moves the object

# --- as JSON data ----------------------------------------------------------------------------------------------------


def data(why: Why, good: GoodRun | None = None) -> dict[str, object]:
    """Return an explanation as JSON data, with the comparison with a good run."""
    return {
        "plan": why.run.plan,
        "outcome": why.run.outcome,
        "thread": why.thread,
        "step": why.step,
        "failure": why.failure and {"type": why.failure.type, "message": why.failure.message},
        "raised": [
            {"type": error.type, "message": error.message, "lines": report.data(error.lines)}
            for error in why.exceptions
        ],
        "causes": [
            report.data(cause) | ({"proof": report.data(proof)} if proof is not None else {})  # type: ignore[operator]
            for cause, proof in zip_longest(why.causes, why.proofs)
        ],
        "task": report.data(why.task),
        "around": report.data(list(why.task.around()) if why.task else []),
        **report.call_stack(why.call_stack),
        "sources": report.data(why.sources),
        "good_run": report.data(good),
        "variables": [
            {"file": file, "line": line, "values": dict(values)} for (file, line), values in why.variables.items()
        ],
        "world": why.world and why.world.name,
        "things": report.data(why.bodies),
        "branches": [report.fields_data(branch, bodies="things") for branch in why.branches],
        "absent": why.removed,
        "tries": [
            report.task_data(attempt.task.motion)
            | {"error": attempt.task.error, "robot": attempt.robot and attempt.robot.pose}
            for attempt in why.attempts
        ],
        "others": why.other_failures,
        "forgotten": why.forgotten,
        "threads": report.data(why.failed_threads),
        "choices": report.data(why.choices),
        "tried": report.data(why.tried),
        "decision": report.data(why.task and why.task.motion.decision),
        "asked": [
            record_data(relevant.query)
            | {"moved_since": relevant.moved, "removed_since": relevant.removed, "other_world": relevant.world}
            for relevant in why.queries
        ],
        "earlier": why.earlier_queries,
        "same": report.data(why.since_same_success),
        "last": report.data(why.since_last_success),
        "running": report.data(why.unfinished),
        "endless": report.data(why.endless),
    }


@report.data.register(TriedTrial)
def _(tried: TriedTrial) -> dict[str, object]:
    trial = tried.trial
    changes = {"step": trial.step, "change": trial.words, "set": trial.settings, "answers": trial.answers}
    return {**changes, "verdict": tried.verdict, "text": tried.text, "file": tried.file}


@report.data.register(Cause)
def _(cause: Cause) -> dict[str, object]:
    own = report.fields_data(cause)
    return {"kind": cause.kind, "steps": own.pop("steps"), "text": " ".join(cause.lines()), **own}


@report.data.register(GoodRun)
def _(good: GoodRun) -> dict[str, object]:
    step, other = good.steps
    edits = [{**report.fields_data(line), "there": text} for line, text in good.edits]
    answers = [{"here": record_data(own), "there": record_data(other)} for own, other in good.answers]
    own = report.fields_data(good)
    return {**own, "edits": edits, "answers": answers, "steps": {"here": step, "there": other}}


@report.data.register(InvolvedBody)
def _(involved: InvolvedBody) -> dict[str, object]:
    return {
        "object": involved.body.name,
        "position": involved.body.position,
        "orientation": involved.body.orientation,
        "held_by": involved.held and involved.held.carrier,
        "holds": [held.body for held in involved.holds],
        "hands": dict(involved.hands),
        "links": {name: {"position": pose[0], "orientation": pose[1]} for name, pose in involved.links.items()},
        "joints": dict(involved.joints),
        "distance": involved.distance,
        "bearing": involved.bearing,
    }


@report.data.register(TriedAction)
def _(tried: TriedAction) -> dict[str, object]:
    return {
        "action": report.data(tried.action),
        "attempts": [report.task_data(attempt) | {"error": attempt.error} for attempt in tried.attempts],
        "imagined": [
            report.task_data(each) | {"foreseen": foreseen(each.finished) if each.finished is not None else ""}
            for each in tried.imagined
        ],
        "places": [
            {"step": query.seq, "name": query.name, "considered": len(query.grid.spots), "text": fates_text(query)}
            for query in tried.places
        ],
        "spent": tried.spent,
        "last": tried.last,
    }


# --- as text ---------------------------------------------------------------------------------------------------------


def lines(why: Why, path: str = "", origins: Iterable[str] = (), good: GoodRun | None = None) -> Iterator[str]:
    """Yield the explanation as text; if ``path`` is given, with commands for the recording.

    ``origins`` are lines about the origins of values, which come first. ``good`` is the comparison with a good run.
    """
    causes = [
        line
        for cause, proof in zip_longest(why.causes, why.proofs)
        for line in (*cause.lines(), *([f"  {proof.text}"] if proof is not None else []))
    ]
    yield from _headline(why)
    forked = bool(why.causes) and why.causes[0].kind == "fork"  # the failure doesn't come from values of the plan
    suspects = [*section("Where the values come from", origins)]
    if why.failure is not None:
        suspects = suspects or [*section("Lines that may have caused it", _sources(why))]
    yield from () if forked else suspects
    yield from section("Unfinished at the end of the recording", _unfinished(why.unfinished))
    yield from section("Unfinished, or finished in a lost record", _unfinished(why.endless))
    if why.failure is None:
        yield from section("Why", causes)
        return
    yield from section("Why" if len(why.causes) < 2 else "Why: causes on record", causes or [_NO_CAUSE])
    yield from suspects if forked else ()
    if good is not None:
        yield from section(f"Compared with {good.file}, where the plan succeeded", good.lines())
    yield from section("Where in the plan", _where(why))
    threads = (
        f"also failed: thread {record.thread}, at step {record.seq}: {phrases.failure(record.failure)}"
        for record in why.failed_threads
    )
    yield from section("What failed", [*_tasks(why), *threads])
    if why.tried is not None:
        yield from section(f"Attempts of {phrases.node(why.tried.action)}", why.tried.lines())
    world = why.world
    where = f" in {world.title}" if world is not None and not (why.is_default and world.lifetime == 1) else ""
    bodies = [line for involved in why.bodies for line in involved.lines()]
    removed = [f"{name} had been removed" for name in why.removed]
    yield from section(f"State{where} at step {why.step}", bodies + removed)
    for branch in why.branches:
        failed = f"{phrases.node(branch.task.motion)}, at step {branch.task.last_step}"
        yield from section(f"Also failed: {failed}", branch.lines())
    yield from section("Attempts", _attempts(why))
    yield from section("Queries on which the plan relied", _queries(why))
    yield from section("Changes since the last success", _changes(why))
    if path:
        yield from section("Look closer", _commands(why, shlex.quote(path)))


def _sources(why: Why) -> Iterator[str]:
    if (case := why.case) is None:
        return
    for each in why.sources:
        slip = oddities(case.source.text(each.file)).get(each.number)
        skipped = "no record shows that it ran" if each in case.skipped(each.file) else ""
        comment = f"perhaps: {slip}" if slip else skipped
        yield f"{phrases.place(each)}  {each.text}" + (f"  # {comment}" if comment else "")


def _headline(why: Why) -> Iterator[str]:
    run, name = why.run, why.run.plan or "the plan"
    interrupted = next((cause for cause in why.causes if isinstance(cause, Interruption)), None)
    if interrupted is not None and interrupted.by:
        yield f"{name} was {next(interrupted.lines())}, after {run.seconds:.1f} s."
        return
    if run.outcome == "failed":
        yield f"{name} failed after {run.seconds:.1f} s: {phrases.one_line(_message(why))}"
    elif run.outcome == "succeeded":
        failed = "a task failed."
        if why.thread and why.failure is not None:
            failed = f"its thread {why.thread} failed: {phrases.failure(why.failure)}"
        yield f"{name} succeeded" + (f", although {failed}" if why.failure is not None else ".")
    elif run.outcome == "interrupted":
        yield f"{name} was interrupted after {run.seconds:.1f} s."
    elif run.outcome == "lost":
        yield f"The end of the recording of {name} is lost; the last readable step is {run.records - 1}."
    else:
        ended = "is still running" if run.outcome == "running" else f"was cut off at step {run.records - 1}"
        yield f"{name} {ended}." + ("" if why.failure else " No task had failed.")
    if why.task is not None:
        yield from _summary(why, why.task)
    warning = why.warning
    if warning is not None and not why.is_python_error:
        yield f"The plan could have known: {_asked_again(warning)} was answered no at step {warning.seq}."


def _message(why: Why) -> str:
    if not why.exceptions:
        return why.run.failure
    error = why.exceptions[-1]
    if error.own and error.type == AssertionError.__name__:
        return format_assertion(error.message, error.lines[-1].text)
    # PyCRAM's messages are clear without the error's type; Python's messages need it
    return error.message if " " in error.message and not hasattr(builtins, error.type) else why.run.failure


def _summary(why: Why, task: Node) -> Iterator[str]:
    motion = task.motion
    error = phrases.one_line(task.error[1] or task.error[0]) if task.error else ""
    if len(why.attempts) > 1:
        name, times = motion.name, f"{'at least ' if why.forgotten else ''}{len(why.attempts)}"
        if why.since_same_success is None:
            yield f"{name} was attempted {times} times and failed each time."
        else:
            yield f"{name} failed {times} times; it last succeeded at step {why.since_same_success.task.last_step}."
        yield f"The last attempt, {phrases.node(motion)}, failed at step {task.last_step}: {error}"
        return
    mistaken = any(isinstance(each, Raised) and not (each.own or each.task) for each in why.causes)
    lead = "The cause:" if why.exceptions and not mistaken else "Before that,"
    yield f"{lead} {phrases.node(motion)} failed at step {task.last_step}: {error}"


def _unfinished(tasks: Sequence[Node]) -> Iterator[str]:
    for task in tasks:
        yield " in ".join(phrases.node(each) for each in task.around()) + f"  [since step {task.started.seq}]"


def _where(why: Why) -> Iterator[str]:
    shown: set[tuple[str, int]] = set()
    # The call stack isn't needed if the tracebacks lead to the task. The traceback of a failed block ends at the block.
    raised = {(line.file, name) for error in why.exceptions for line in error.lines for name in ("", line.function)}
    leads = any((line.file, line.function) in raised for line in why.call_stack[-1:])
    for line in () if leads else why.call_stack:
        shown.add((line.file, line.number))
        yield from _line(line, why)
    for error in why.exceptions:
        every = {(line.file, line.number): line for line in error.lines}  # a comprehension may have its own frame
        fresh = [line for place, line in every.items() if place not in shown]
        if shown and fresh:
            yield f"which raised {error.type}:"
        for line in fresh:
            shown.add((line.file, line.number))
            yield from _line(line, why)


def _line(line: Line, why: Why) -> Iterator[str]:
    yield phrases.place(line) + (f" in {line.function}" if line.function else "")
    if line.text:
        yield f"    {line.text}"
    rows = [""]
    for name, value in why.variables.get((line.file, line.number), {}).items():
        if rows[-1] and len(rows[-1]) + len(name) + len(value) > _WIDTH:
            rows.append("")
        rows[-1] += f"{', ' if rows[-1] else ''}{name}={phrases.one_line(value)}"
    yield from (f"    with {row}" for row in rows[:_MAX_ROWS] if row)
    if len(rows) > _MAX_ROWS:
        yield "    and more: see `why --json`"


def _tasks(why: Why) -> Iterator[str]:
    if why.task is None:
        if why.failure is not None:
            yield f"no task: this was raised outside of tasks{f', in thread {why.thread}' if why.thread else ''}"
            yield from (f"  {line}" for line in format_failure(why.failure).splitlines())
        return
    path = list(why.task.around())[::-1]
    for depth, task in enumerate(path):
        if task.finished is None and task is not why.task:
            state = "not finished"
        else:
            took = phrases.seconds(task.finished.duration_ns) if task.finished is not None else ""
            state = f"failed after {took}" if task.failed else f"continued, {took}"
        yield f"{'  ' * depth}{phrases.node(task)}  [steps {task.started.seq}-{task.last_step}, {state}]"
        if task is why.task.motion and task.decision is not None:
            yield f"{'  ' * depth}    {decision_text(task.decision, full=True)}"
    for choice in why.choices[-_LAST:]:
        yield f"{'  ' * len(path)}{phrases.question(choice)}: {chosen_name(choice) or 'none'}  [step {choice.seq}]"
        yield from (f"{'  ' * len(path)}    {line}" for line in rejection_lines(choice))
    if why.task.failure is not None:
        yield from (f"{'  ' * len(path)}{line}" for line in format_failure(why.task.failure).splitlines())
    attempted = {attempt.task for attempt in why.attempts}  # attempts are listed in their own section
    siblings = (part for part in why.task.outermost_failed.children if part.failed and part not in path)
    for part in islice((part for part in siblings if part.origin not in attempted), _LAST):
        yield f"also failed: {phrases.node(part)}: {phrases.one_line(part.error[1]) if part.error else ''}"


def _attempts(why: Why) -> Iterator[str]:
    if why.other_failures:
        yield f"{why.other_failures} earlier failure{'s' * (why.other_failures > 1)} (see `pycram-replay tree`)"
    if why.forgotten:
        yield f"{why.forgotten} earlier failures are left out, as there are too many"
    if len(why.attempts) < 2:
        return
    *earlier, last = (attempt.task.motion.parameters for attempt in why.attempts)
    varying = [key for key in last if any(parameters.get(key) != last[key] for parameters in earlier)]
    poses = [
        f"{robot.name} at {phrases.vector(robot.position[:2])} facing {facing(robot)}" if robot is not None else ""
        for robot in (attempt.robot for attempt in why.attempts)
    ]
    differ = len({pose for pose in poses if pose}) > 1
    groups: list[tuple[str, str, list[int]]] = []  # parameters, error and steps of successive equal attempts
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


def _queries(why: Why) -> Iterator[str]:
    if why.earlier_queries:
        yield f"... {why.earlier_queries} earlier queries ..."
    for relevant in why.queries:
        query = relevant.query
        reasons = phrases.reasons(query)
        yield f"step {query.seq}: {phrases.question(query)}"
        yield f"    {phrases.answer(query)}" + (f": {reasons}" if reasons else "")
        if relevant.world:
            yield f"    it was asked in another world: {relevant.world}"
        if relevant.moved:
            yield f"    later {phrases.names(relevant.moved)} moved"
        if relevant.removed:
            were = "was" if len(relevant.removed) == 1 else "were"
            yield f"    later {phrases.names(relevant.removed)} {were} removed"


def _changes(why: Why) -> Iterator[str]:
    if why.task is not None:
        motion = why.task.motion
        if why.since_same_success is None:
            yield f"No {phrases.task(motion.kind, motion.name, {})} succeeded before."
        else:
            yield from _since(why.since_same_success)
    same, last = why.since_same_success, why.since_last_success
    if last is not None and (same is None or same.task is not last.task):
        yield from _since(last)


def _since(since: ChangesSince) -> Iterator[str]:
    task = since.task
    changes = list(difference_lines(since.difference)) if since.difference.notable or since.difference.added else []
    name = f"{phrases.node(task)} succeeded at step {task.last_step}"
    if not changes:
        yield f"{name}; nothing has moved since."
        return
    yield f"{name}; changes since:"
    yield from (f"  {line}" for line in changes[:_MAX_LINES])
    if len(changes) > _MAX_LINES:
        yield f"  ... {len(changes) - _MAX_LINES} more lines; `diff` prints all"


def _commands(why: Why, path: str) -> Iterator[str]:
    """Yield commands for details. ``path`` is in quotes for a shell."""
    world = "" if why.world is None or why.is_default else f" --world {shlex.quote(why.world.name)}"
    if why.causes and not why.proofs and why.run.outcome == "failed":
        yield f"pycram-replay why {path} --prove"
        yield f"pycram-replay fix {path}"
    if why.queries:
        yield f"pycram-replay show {path} {why.queries[-1].query.seq}"
    names = [involved.body.name for involved in _movable(why)]
    if names:
        name = shlex.quote(names[-1])
        yield f"pycram-replay state {path} {why.step} {name}{world}"
        yield f"pycram-replay blame {path} {name} --at {why.step}{world}"
    if why.warning is not None:
        yield f"pycram-replay ask {path} {why.step} {shlex.quote(_asked_again(why.warning))}{_nearer(why)}{world}"
    if names:
        yield f"pycram-replay render {path} {why.step} -o moment.png{world}"
        yield f"pycram-replay restore {path} {why.step} --shell{world}"


def _asked_again(query: Query) -> str:
    """Return a query as a question for ``ask``; thresholds are left out."""
    arguments: list[Term] = []
    try:
        question = question_of(query)
    except BadQuestion:
        return phrases.question(query)
    for name, term in question.keywords.items():
        if name in ("threshold", "margin", "grasp", "orientation", "collision_free"):
            break
        arguments.append(Name(term) if isinstance(term, str) else term)  # queries accept both names and strings
    return str(QueryCall(query.name, tuple(arguments)))


def _movable(why: Why) -> list[InvolvedBody]:
    """Return the robot and the movable bodies; if there are none, all bodies."""
    movable = [each for each in why.bodies if each.is_robot or not each.body.fixed_base]
    return movable if len(movable) > 1 else list(why.bodies)


def _nearer(why: Why) -> str:
    """Return the command-line option that moves the object nearer to the robot; "" if there is no robot."""
    robot = next((involved.body for involved in why.bodies if involved.is_robot), None)
    last = next(reversed(_movable(why)), None)  # the bodies may be missing in a damaged recording
    if robot is None or last is None or last.distance is None or last.distance <= _NEARER:
        return ""
    share = _NEARER / last.distance
    target = [a + (b - a) * share for a, b in zip(last.body.position[:2], robot.position[:2], strict=True)]
    return f" --move {shlex.quote(last.body.name)}={target[0]:.2f},{target[1]:.2f},{last.body.position[2]:.2f}"
