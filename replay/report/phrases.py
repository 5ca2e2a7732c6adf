"""Phrases for values, numbers, lines of the plan, tasks, changes, records, answers and evidence."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import takewhile
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder import notebook, records
from recorder.records.text import is_choice, link_text, pair_text, rejection_lines, rejections, text_of
from recorder.tasks import Node
from replay.state.state import Attachment, Sampled

if TYPE_CHECKING:
    from replay.history.source import Line

_WIDTH: Final = 100  # maximum number of characters of a value
_MAX_NAMES: Final = 4  # maximum number of names in a list
_MAX_REASONS: Final = 3  # maximum number of reasons in a line
_PLAIN_KINDS: Final = frozenset({"motion", "process-module", "failure-handling", "attempt"})


def value(recorded: records.Plain) -> str:
    """Return a recorded value with names of bodies, and numbers with three decimals."""
    if isinstance(recorded, dict):
        if set(recorded) == {"object", "world"}:
            return str(recorded["object"])
        if len(recorded) == 1 and isinstance(next(iter(recorded.values())), str):  # {"repr": ...} or {"callable": ...}
            return str(next(iter(recorded.values())))
        text = "{" + ", ".join(f"{key}: {value(item)}" for key, item in recorded.items()) + "}"
    elif isinstance(recorded, list):
        text = "[" + ", ".join(value(item) for item in recorded) + "]"
    elif isinstance(recorded, float):
        text = number(recorded)
    elif isinstance(recorded, str):
        text = recorded
    else:
        text = json.dumps(recorded)
    return short(text)


def short(text: str) -> str:
    """Return a text, cut to the width of a line."""
    return text if len(text) <= _WIDTH else text[: _WIDTH - 3] + "..."


def one_line(text: str) -> str:
    """Return the first line of a text, with "..." if further lines follow."""
    first, _, more = text.strip().partition("\n")
    return f"{first} ..." if more else first


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{share:.0%}" if share in (0, 1) or 0.01 <= share <= 0.99 else f"{share:.1%}"


def plural(count: int, what: str) -> str:
    """Return a count with its noun in singular or plural."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def names(items: Sequence[str]) -> str:
    """Return the first names and the number of others, such as "a, b and 3 more"."""
    shown = list(items[:_MAX_NAMES])
    if len(items) > _MAX_NAMES:
        shown.append(f"{len(items) - _MAX_NAMES} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else "nothing"


def number(amount: float) -> str:
    """Return a number with three decimals, without trailing zeros."""
    text = f"{amount:.3f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def apart(before: float, after: float) -> tuple[str, str]:
    """Return two numbers with enough digits to tell them apart."""
    if number(before) != number(after) or before == after:
        return number(before), number(after)
    texts = ((f"{before:.{digits}g}", f"{after:.{digits}g}") for digits in range(3, 17))
    return next((pair for pair in texts if pair[0] != pair[1]), (repr(before), repr(after)))


def vector(values: Sequence[float]) -> str:
    """Return a vector, such as a position."""
    return "[" + ", ".join(number(part) for part in values) + "]"


def vectors(before: Sequence[float], after: Sequence[float]) -> tuple[str, str]:
    """Return two vectors with enough digits to tell them apart."""
    pairs = [apart(a, b) for a, b in zip(before, after, strict=True)]
    return f"[{', '.join(a for a, _ in pairs)}]", f"[{', '.join(b for _, b in pairs)}]"


def length(metres: float) -> str:
    """Return a distance."""
    if metres >= 0.1:
        return f"{metres:.3f} m"
    return f"{metres * 1e3:.1f} mm" if metres >= 5e-5 else f"{metres * 1e3:.1g} mm"


def degrees(angle: float) -> str:
    """Return an angle, given in rad, in degrees."""
    value = math.degrees(angle)
    return f"{value:.1f} degrees" if value >= 0.05 else f"{value:.1g} degrees"


def turned(angle: float) -> str:
    """Return the text of a turn by an angle in rad."""
    return f"turned by {degrees(angle)}"


def seconds(duration_ns: int) -> str:
    """Return a duration in s or ms."""
    return f"{duration_ns / 1e9:.2f} s" if duration_ns >= 1e9 else f"{duration_ns / 1e6:.1f} ms"


# --- the plan: lines, tasks, failures ---------------------------------------------------------------------------------


def path(file: str) -> str:
    """Return the path of a file. A path in the current folder is relative."""
    with suppress(ValueError, OSError):
        return str(PurePath(file).relative_to(Path.cwd()))
    return file


def place(line: Line) -> str:
    """Return the place of a line of the plan: "file:line", or "In [3], line 1" in a notebook."""
    return notebook.place(path(line.file), line.number)


def at(line: Line | None) -> str:
    """Return ", at file:line" for the end of a clause; "" if the line is unknown."""
    return f", at {place(line)}" if line is not None else ""


def location(line: Line) -> str:
    """Return the location and the text of a line of the plan."""
    function = f" in {line.function}" if line.function else ""
    return f"{place(line)}{function}" + (f":  {short(line.text)}" if line.text else "")


def call_stack_lines(stack: Sequence[Line], printed: list[Sequence[Line]]) -> Iterator[str]:
    """Yield a call stack, innermost line first; outer lines that another stack has already printed are left out."""
    common = (takewhile(lambda pair: pair[0] == pair[1], zip(stack, earlier, strict=False)) for earlier in printed)
    shared = max((len(list(pairs)) for pairs in common), default=0)
    printed.append(stack)
    word = "from"
    for line in reversed(stack[shared:] if shared > 1 else stack):
        yield f"{word} {location(line)}"
        word = "called from"
    if shared > 1:
        yield f"{word} {location(replace(stack[shared - 1], text=''))}, as above"


def call(name: str, parameters: Mapping[str, records.Plain]) -> str:
    """Return the text of a task or query with its parameters."""
    arguments = ", ".join(f"{key}={value(item)}" for key, item in parameters.items() if item is not None)
    return f"{name}({arguments})" if arguments else name


def task(kind: str, name: str, parameters: Mapping[str, records.Plain]) -> str:
    """Return a task with its parameters, and with its kind if the name doesn't imply the kind."""
    if kind == "handler":
        return f"handler {name} of event {parameters.get('event', '')}"
    if kind == "timeout":
        from recorder.records.text import timeout_text  # noqa: PLC0415  imported here: few verbs need this module

        return timeout_text(name, parameters.get("clock"))
    called = name if kind == "process-module" else call(name, parameters)
    return called if kind in _PLAIN_KINDS else f"{called} {kind}"


def node(task_: Node) -> str:
    """Return a task with its parameters."""
    return task(task_.kind, task_.name, task_.parameters)


def error(task_: Node) -> str:
    """Return the error of a task in one line; for a task without an error, its status."""
    return one_line(task_.error[1] or task_.error[0]) if task_.error is not None else task_.status.word


def failure(failed: records.Failure) -> str:
    """Return a failure in one line."""
    return one_line(records.format_failure(failed))


def refused(refusal: records.Refusal) -> str:
    """Return the refused call."""
    return call(refusal.name, records.argument_values(refusal.arguments))


def handler(started: records.Task) -> str:
    """Return the call of a handler, with the step of the event."""
    event = records.argument_values(started.parameters).get("event", "")
    step = f" of step {started.cause}" if started.cause else ""  # the cause 0 stands for an event before the recording
    return f"the handler {started.name} of event {event}{step}"


# --- the world: changes, attachments, beliefs -------------------------------------------------------------------------

#: Verbs for each kind of change (the field ``how`` of :class:`replay.history.blame.Blame`, and of causes of failures).
_CHANGES: Final[Mapping[str, str]] = {
    "command": "was moved",
    "carried": "was carried",
    "along": "moved along",
    "hand": "was dragged by hand in the window",
    "driven": "followed a trajectory",
    "physics": "moved in simulation",
    "reset": "moved when the world was reset",
    "restored": "moved when a saved state was restored",
    "load": "was loaded",
    "removed": "was removed",
    "attached": "was attached",
    "detached": "was detached",
    "in-hand": "was moved away from the hand that held it",
}


def change(name: str, how: str, mover: str = "") -> str:
    """Return the change of a body or joint. ``mover`` is the body that carried the changed body, or moved it along."""
    if how in ("gravity", "joints"):
        return "gravity was set" if how == "gravity" else f"joints of {name} moved"
    word = {"carried": "by", "along": "with"}.get(how) if mover else None
    return f"{name} {_CHANGES.get(how, 'changed')}" + (f" {word} {mover}" if word else "")


def carrier(held: Attachment) -> str:
    """Return a carrier and the link that holds the body."""
    return held.carrier + (f" ({held.carrier_link})" if held.carrier_link else "")


def learned(source: str, step: int) -> str:
    """Return the source of a belief as text, such as "seen at step 40"."""
    words = {"held": "in its hand since", "told": "read from the world's state at", "placed": "released there at"}
    word = words.get(source, f"{source} at")
    return f"{word} step {step}" if step >= 0 else f"{word.rpartition(' ')[0]} before the recording"


def sampled(moment: Sampled, *, exact: bool = False) -> str:
    """Return a moment within a simulation as text, and how its state is known."""
    stretch = f"step {moment.step} ({moment.world} simulated from {moment.start:.3f} s to {moment.end:.3f} s)"
    if exact:
        return f"at {moment.asked:.3f} s, within {stretch}: simulated again up to that time"
    if moment.at == moment.start:
        return f"at {moment.asked:.3f} s, within {stretch}: the state before the simulation, as nothing had moved yet"
    return f"at {moment.asked:.3f} s, within {stretch}: sampled at {moment.at:.3f} s, accurate to 0.01 mm"


# --- records ----------------------------------------------------------------------------------------------------------


def record_line(record: records.Record) -> str:
    """Return the line that describes a record."""
    if isinstance(record, records.Task) and record.phase == records.Task.STARTED:
        earlier = ", already running" if record.began_ns else ""
        return f"{record.kind} {call(record.name, records.argument_values(record.parameters))}{earlier}"
    if isinstance(record, records.Query):
        text = reasons(record)
        return f"{question(record)}: {answer(record)}" + (f"; {text}" if text else "")
    if isinstance(record, records.Event):
        text = f"event {call(record.name, records.argument_values(record.arguments))}"
        return f"{text}, {len(record.handlers)} handlers" if record.handlers else text
    if isinstance(record, records.Refusal):
        return f"refused: {refused(record)}: {failure(record.failure)}"
    return "; ".join(text_of(record)[0].splitlines())


def question(query: records.Query) -> str:
    """Return a query with its arguments as text."""
    return call(query.name, records.argument_values(query.arguments))


def answer(query: records.Query) -> str:
    """Return the answer of a query: yes, no, objects, or the failure. The text names an answer that a fork has set."""
    if query.HasField("failure"):
        return failure(query.failure)
    if query.by_fork:
        own = f" (own answer: {_answer(query.own_answer_json)})" if query.own_answer_json else ""
        return f"{_answer(query.answer_json)}, set by the fork{own}"
    return _answer(query.answer_json)


def _answer(text: str) -> str:
    result = records.from_json(text)
    if isinstance(result, bool):
        return "yes" if result else "no"
    return names([value(item) for item in result]) if isinstance(result, list) else value(result)


def reasons(query: records.Query) -> str:
    """Return the evidence for an answer as text, with the reasons for rejected candidates."""
    evidence = records.argument_values(query.evidence)
    found = []
    for key, item in evidence.items():
        if key in _EVIDENCE:
            found.append(_EVIDENCE[key](item, evidence))
        elif key not in _INCLUDED and isinstance(item, bool | int | float | str):
            found.append(f"{key.replace('_', ' ')} {value(item)}")
    if is_choice(query):
        found.insert(0, rejections(query))
    lines = [] if is_choice(query) or len(query.candidates) < 2 else list(rejection_lines(query))
    more = [f"{len(lines) - _MAX_REASONS} more reasons"] if len(lines) > _MAX_REASONS else []
    return "; ".join(filter(None, (", ".join(filter(None, found)), *lines[:_MAX_REASONS], *more)))


# --- evidence of queries ----------------------------------------------------------------------------------------------

_Evidence: TypeAlias = "Mapping[str, records.Plain]"


def _share(share: records.Plain, evidence: _Evidence) -> str:
    if not isinstance(share, int | float):
        return ""
    visible, unoccluded = evidence.get("pixels_seen"), evidence.get("pixels_alone")
    how_much = "all" if share >= 1 else "nothing" if not share else f"{share:.0%}"
    return f"{how_much} of it is visible" + (f" ({visible} of {unoccluded} pixels)" if unoccluded else "")


def _hidden(bodies: records.Plain, evidence: _Evidence) -> str:
    shares = bodies.items() if isinstance(bodies, dict) else ()
    found = evidence.get("hiding_links")
    links = found if isinstance(found, dict) else {}
    return ", ".join(
        f"{link_text(name, str(links.get(name, '')))} hides "
        f"{f'{share:.0%}' if isinstance(share, int | float) else 'it'}"
        for name, share in shares
    )


def _distance(distance: records.Plain, evidence: _Evidence) -> str:
    if not isinstance(distance, int | float):
        return ""
    if "joints" not in evidence:
        return f"{number(abs(distance) * 1e3)} mm {'apart' if distance >= 0 else 'deep'}"
    turn = evidence.get("turn")
    turned = ""
    if isinstance(turn, int | float) and turn >= math.radians(1):
        turned = f" and is turned by {math.degrees(turn):.0f} degrees"
    if distance < 1e-3 and not turned:
        return "a posture reaches it"
    return f"the nearest posture found stays {distance:.3f} m away{turned}"


def _obstacles(bodies: records.Plain, _: _Evidence) -> str:
    if not isinstance(bodies, dict) or not bodies:
        return ""
    pairs = [fact["pair"] if isinstance(fact, dict) and "pair" in fact else None for fact in bodies.values()]
    known = [pair_text(pair) for pair in pairs if isinstance(pair, dict)]
    if len(known) == len(bodies):
        return names(known)
    return f"the arm would touch {names(list(bodies))}"  # older recordings lack these links


def _links(links: records.Plain, _: _Evidence) -> str:
    if not isinstance(links, list) or not links:
        return ""
    pairs = (item if isinstance(item, list) else [item] for item in links)
    return f"at {names([' and '.join(str(part) or 'base' for part in pair) for pair in pairs])}"


def _measure(text: str, factor: float) -> Callable[[records.Plain, _Evidence], str]:
    """Return a phrase for an amount with a unit. ``text`` formats the amount after multiplication by the factor."""
    return lambda amount, _: text.format(amount * factor) if isinstance(amount, int | float) else ""


#: Phrases for the parts of a query's evidence. Values without a phrase are printed with their names.
_EVIDENCE: Final[Mapping[str, Callable[[records.Plain, _Evidence], str]]] = {
    "share": _share,
    "hidden_by": _hidden,
    "outside": _measure("{:.0f} % of it is outside of the picture", 100),
    "distance": _distance,
    "obstacles": _obstacles,
    "moved": _measure("it moved {:.1f} mm", 1e3),
    "turned": _measure("turned {:.1f} degrees", math.degrees(1)),
    "links": _links,
    "simulated_steps": lambda steps, _: (
        f"in {steps / records.STEPS_PER_SECOND:.2f} s of simulation" if isinstance(steps, int) else ""
    ),
}
#: Parts of the evidence that the phrases of other parts include.
_INCLUDED: Final = frozenset({"hiding_links", "pixels_seen", "pixels_alone", "reached", "turn", "moved_after_steps"})
