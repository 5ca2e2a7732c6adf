"""Records as text: a line for each record, also for other tools (``foxglove.Log`` on /log).

Lists of records are copied (``[:]``) for iteration: protobuf's own iterators take three times as long.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder import records

if TYPE_CHECKING:
    Line: TypeAlias = tuple[str, Log.Level.ValueType]  # a text, and its level in the log

_NS: Final = 1_000_000_000
_DEBUG, _INFO, _WARNING, _ERROR = Log.DEBUG, Log.INFO, Log.WARNING, Log.ERROR
_OF_PLAN: Final = frozenset({records.Task, records.Run, records.Output})
_LEVELS: Final = {"DEBUG": _DEBUG, "INFO": _INFO, "WARNING": _WARNING, "ERROR": _ERROR, "CRITICAL": _ERROR}
_LITTLE: Final = 0.005  # texts mention a share of an object outside of the picture from this share on
_NOTABLE_ERROR: Final = 0.01  # minimum error of a motor, rad or m, that texts mention
_THREE: Final = "[%.3f, %.3f, %.3f]"  # for the most frequent length, this is faster than a loop


def log_line(record: records.Record, time_ns: int) -> bytes | None:
    """Return the serialized line of a record; None if it has none. The time is in ns since the Unix epoch."""
    if not has_line(record):
        return None
    kind = type(record)
    text, level = _TEXTS[kind](record)
    line = Log(message=text, level=level, name="plan" if kind in _OF_PLAN else record.world or "plan")
    line.timestamp.seconds, line.timestamp.nanos = divmod(time_ns, _NS)
    return line.SerializeToString()


def has_line(record: records.Record) -> bool:
    """Return whether a record has a line: all records except keyframes and requests for tasks."""
    if type(record) is records.Task:  # isinstance would take five times as long
        return record.phase != records.Task.ASKED
    return type(record) is not records.Keyframe


def text_of(record: records.Record) -> Line:
    """Return the text and level of a record's line."""
    return _TEXTS[type(record)](record)


def _run(record: records.Run) -> Line:
    if record.phase == records.Run.STARTED:
        return f"{record.name} started", _INFO
    if record.phase == records.Run.THREAD_FAILED:
        return f"thread {record.thread} failed: {records.format_failure(record.failure)}", _ERROR
    if record.succeeded:
        return f"{record.name} succeeded after {record.duration_ns / _NS:.3f} s", _INFO
    return f"{record.name} failed: {records.format_failure(record.failure)}", _ERROR


def _task(record: records.Task) -> Line:
    name, phase = f"{record.kind} {record.name}", record.phase
    if phase == records.Task.STARTED:
        return f"{name}({values(record.parameters)}){', already running' if record.began_ns else ''}", _INFO
    if phase == records.Task.ASKED:
        return f"{name} requested", _DEBUG
    if phase == records.Task.LEFT:
        return f"{name} still runs when the recording ends", _INFO
    took, status = f"{record.duration_ns / 1e6:.1f} ms", record.status
    if status == records.Task.CANCELLED or is_timed_out(record):
        return f"{name} {'was cancelled' if status == records.Task.CANCELLED else 'timed out'} after {took}", _WARNING
    decided = ""
    if record.kind == "motion" and record.HasField("decision") and (text := decision_text(record.decision)):
        decided = f", {text}"  # the record of the process module contains the same decision
    if status == records.Task.SUCCEEDED:
        return f"{name} succeeded in {took}{decided}" + (f": {text}" if (text := foreseen(record)) else ""), _INFO
    return f"{name} failed after {took}{decided}: {records.format_failure(record.failure)}", _ERROR


def overlap_texts(body: str, overlaps: Iterable[records.Overlap], *, fixed: bool) -> list[str]:
    """Return a text for each overlap of a loaded body. A free body is inside of a fixed body, in either order."""
    pairs = [(each, (each.body, body) if fixed else (body, each.body)) for each in overlaps]
    return [f"{inner} is {each.depth * 1e3:.0f} mm inside of {outer}" for each, (inner, outer) in pairs]


def is_timed_out(record: records.Task) -> bool:
    """Return whether a record is the end of a wait that timed out; such a wait has the status succeeded."""
    return record.kind == "wait" and record.phase == records.Task.FINISHED and record.result_json == "false"


def _query(record: records.Query) -> Line:
    asked = f"{record.name}({values(record.arguments)})"
    rejected = f"; {text}" if record.candidates and (text := rejections(record)) else ""
    if record.HasField("failure"):
        return f"{asked} raised {record.failure.type}{rejected}", _WARNING
    own = f" (own answer: {by_name(record.own_answer_json)})" if record.own_answer_json else ""
    by = f", set by the fork{own}" if record.by_fork else ""
    return f"{asked} -> {by_name(record.answer_json)}{by}{rejected}", _INFO


def _fluent(record: records.Fluent) -> Line:
    name, after = f"fluent {record.name}", record.after_json
    if record.by_fork:
        return f"{name}: {record.before_json} -> {after}, by the fork", _DEBUG
    if record.before_json == after:
        return f"{name} pulsed at {after}" if after else f"{name} pulsed", _DEBUG
    return f"{name}: {record.before_json} -> {after}", _DEBUG


def _check(record: records.Check) -> Line:
    if record.phase == records.Check.WATCHED:
        return f"watched: {record.property}", _INFO
    when = f"step {record.step} ({record.moment / records.STEPS_PER_SECOND:.3f} s)"
    reason = f", {record.reason}" if record.reason else ""
    found = f"; {values(record.values)}" if record.values else ""
    return f"violated: {record.property} at {when}{reason}{found}", _ERROR


_TEXTS: Final[Mapping[type[records.Record], Callable[[Any], Line]]] = {
    records.Task: _task,
    records.Mutation: lambda record: (mutation_text(record), _DEBUG),
    records.Query: _query,
    records.Event: lambda record: (
        f"event {record.name}({values(record.arguments)}), {len(record.handlers)} handlers",
        _INFO,
    ),
    records.Subscription: lambda record: (
        f"handler {record.handler} {'removed from' if record.removed else 'added to'} event {record.name}"
        + (f" of {record.sender}" if record.sender else ""),
        _DEBUG,
    ),
    records.Refusal: lambda record: (
        f"refused: {record.name}({values(record.arguments)}): {records.format_failure(record.failure)}",
        _WARNING,
    ),
    records.Fluent: _fluent,
    records.Check: _check,
    records.Run: _run,
    records.Output: lambda record: (
        (f"{record.logger} {record.level}: {record.text}", _LEVELS.get(record.level, _INFO))
        if record.stream == "logging"
        else (f"{record.stream}: {record.text}", _WARNING if record.stream == "stderr" else _INFO)
    ),
    records.Keyframe: lambda record: (f"keyframe of {record.world}", _DEBUG),
    records.Envelope: lambda _: ("a record of a kind that this release doesn't know", _DEBUG),
}

# Mutations


def mutation_text(record: records.Mutation) -> str:
    """Return the text of a mutation's change, in a few words."""
    name = str(record.WhichOneof("command") or "change")
    command = getattr(record, name, None)
    details = _DETAILS.get(name)
    text = name.replace("_", " ") + (f" {details(command)}" if details else "")
    text += ", by the fork" if record.by_fork else ""
    if name == "simulate":
        dragged = " and ".join(dict.fromkeys(drag.body for drag in record.drags[:]))
        return f"{text}, while {dragged} was dragged by hand" if dragged else text
    body = getattr(command, "body", "")
    along = [name for state in record.effect.bodies[:] if (name := state.body) != body]
    return f"{text}, along with {', '.join(along)}" if along else text


def _numbers(values: Sequence[float]) -> str:
    numbers = (*values[:],)
    return _THREE % numbers if len(numbers) == 3 else f"[{', '.join([f'{number:.3f}' for number in numbers])}]"


def _simulated(command: records.Simulate) -> str:
    text = f"{command.steps} steps"
    for driven in command.driven[:]:
        text += f", {driven.body} at {driven.time:.3f} s of trajectory {driven.number}"
        text += ", which has ended" if driven.ended else ""
        text += f" ({driven.joint} {driven.error:.3f} off)" if driven.error > _NOTABLE_ERROR else ""
    if command.driven or not command.HasField("settled"):
        return text
    return f"{text} until everything was at rest" if command.settled else f"{text}; not everything is at rest yet"


def _began(command: records.BeginTrajectory) -> str:
    trajectory, search = command.trajectory, command.search
    count = len(trajectory.joints)
    moved = f"{count} joints" if count > 1 else trajectory.joints[0] if count else "base"
    took = f"{trajectory.times[-1]:.3f} s" if trajectory.times else "no time"
    text = f"{command.number}: {moved} of {command.body}, {took}"
    if not search.planner:
        return text
    checks = f" after {search.checks} checks" if search.checks else ""
    return f"{text}, {'along a given path' if search.planner == 'given' else search.planner}{checks}"


_DETAILS: Final[Mapping[str, Callable[[Any], str]]] = {  # details by command
    "open_world": lambda command: str(command.mode),
    "load_body": lambda command: (
        f"{command.body} {_numbers(command.position)}"
        + (f", scale {command.scale:g}" if command.scale else "")
        + "".join([f", {text}" for text in overlap_texts(command.body, command.overlaps[:], fixed=command.fixed_base)])
    ),
    "remove_body": lambda command: command.body,
    "move_body": lambda command: f"{command.body} {_numbers(command.position)}",
    "move_joints": lambda command: (
        f"{command.body} "
        + (
            f"{command.joints[0]} {command.positions[0]:.3f}"
            if (count := len(command.joints)) == 1
            else f"{count} joints"
        )
    ),
    "attach_body": lambda command: (
        f"{command.body} to {command.carrier} {command.carrier_link}"
        + (f", with {', '.join(command.along)}" if command.along else "")
        + (f", leaving {', '.join(command.left)}" if command.left else "")
    ),
    "detach_body": lambda command: f"{command.body} from {command.carrier}",
    "set_gravity": lambda command: _numbers(command.gravity),
    "set_realtime": lambda command: "on" if command.enabled else "off",
    "set_color": lambda command: command.body,
    "set_robot": lambda command: command.body,
    "simulate": _simulated,
    "begin_trajectory": _began,
    "stop_trajectory": lambda command: f"{command.number} of {command.body}",
    "restore": lambda command: f"the state of {command.sim_step / records.STEPS_PER_SECOND:.3f} s",
}

# Decisions

_OWN_RESOLVER: Final = "pycram.motions.motion_types.resolve"
_OWN_ENVIRONMENT: Final = "simulated"


def decision_text(decision: records.Decision, *, full: bool = False) -> str:
    """Return the text of a motion's decision. ``full`` also includes default values."""
    parts = []
    if full or decision.solution or decision.known > 1 or decision.resolver not in ("", _OWN_RESOLVER):
        which = f"solution {decision.solution + 1} of {decision.known}{'' if decision.complete else ' or more'}"
        made = "its data" if decision.known else "no solution"
        parts.append(f"{which} by {decision.resolver}" if decision.resolver else made)
    if full or decision.chooser or decision.registered_for:
        module = decision.module or "no process module"
        why = f"for {decision.registered_for}" if decision.registered_for else ""
        why = f"chosen by {decision.chooser}" if decision.chooser else why
        parts.append(f"{module} {why}".strip())
    if full or decision.environment not in ("", _OWN_ENVIRONMENT):
        parts.append(f"in the {decision.environment} environment")
    return ", ".join(parts)


# Candidates of queries

_ANSWERS: Final = ("true", "false", "[")  # the beginnings of yes, no and lists in JSON


def is_choice(query: records.Query) -> bool:
    """Return whether a process module chose a candidate with this query."""
    return query.HasField("chosen") and not query.answer_json.startswith(_ANSWERS)


def chosen_name(query: records.Query) -> str:
    """Return the name of a query's chosen candidate; "" if there is none."""
    known = query.HasField("chosen") and 0 <= query.chosen < len(query.candidates)
    return ", ".join(query.candidates[query.chosen].names) if known else ""


def rejections(query: records.Query) -> str:
    """Return a line of the reasons for which a query rejected candidates; "" if there are none. Places are counted."""
    return fates_text(query) if query.grid.spots else "; ".join(rejection_lines(query))


def rejection_lines(query: records.Query) -> Iterator[str]:
    """Yield a line for each rejection of a query, with the rejected candidates and the reason."""
    if query.grid.spots:
        yield fates_text(query)
    chosen = query.chosen if query.HasField("chosen") else -1
    for number, candidate in enumerate(query.candidates[:]):
        if number != chosen:
            yield f"{_named(candidate)}: {reason_text(candidate)}" if candidate.names else _named(candidate)


def _named(candidate: records.Candidate) -> str:
    names, count = list(candidate.names), max(candidate.count, len(candidate.names))
    if not names:
        return f"{count} more were rejected"
    more = f" ({count})" if len(names) == 1 < count else f" and {count - len(names)} more" if count > len(names) else ""
    return ", ".join(names) + more


def reason_text(candidate: records.Candidate) -> str:
    """Return the text of the reason for a rejection. The text of a user's own reason is its type and values."""
    data: Mapping[str, Any] = records.argument_values(candidate.data)
    text = rejection_text(candidate.reason, data)
    if text and candidate.count > 1:  # the values are those of the candidate that came nearest
        text = {"OutOfReach": f"{text} at best", "Misfit": "at best " * text[0].isdigit() + text}.get(
            candidate.reason, text
        )
    return text or f"{candidate.reason}({', '.join(f'{name}={value}' for name, value in data.items())})"


def rejection_text(reason: str, data: Mapping[str, Any]) -> str:
    """Return the text for a rejection's type and data; "" for types that a user has defined, and for damaged data."""
    phrase = _REASONS.get(reason)
    try:
        return phrase(data) if phrase is not None else ""
    except (KeyError, TypeError, ValueError, AttributeError):  # the data is damaged or comes from another release
        return ""


def pair_text(pair: Mapping[str, object]) -> str:
    """Return a collision pair as text, such as "milk in the left gripper would touch sink_area_surface of kitchen".

    In the pair, ``mover`` and ``link`` are the moving body and its link; ``gripper`` is the gripper that holds the
    body. ``body`` and ``body_link`` are the touched body and its link. If a body has a single link, the link is "".
    """
    mover, link, body, body_link = (str(pair.get(key) or "") for key in ("mover", "link", "body", "body_link"))
    moved = f"{mover} in the {pair['gripper']} gripper" if pair.get("gripper") else link or mover
    if body == mover:
        return f"its own {moved} would touch {body_link}"
    return f"{moved} would touch {link_text(body, body_link)}"


def link_text(body: str, link: str) -> str:
    """Return "LINK of BODY", or only the body if the link is "" or has the name of the body."""
    return f"{link} of {body}" if link not in ("", body) else body


def _pairs(data: Mapping[str, Any]) -> str:
    return ", ".join(pair_text(pair) for pair in data["pairs"])


def _out_of_reach(data: Mapping[str, Any]) -> str:
    distance, turn = data["distance"], math.degrees(data.get("turn") or 0.0)
    parts = [f"{distance:.3f} m"] if distance else []
    parts += [f"{turn:.0f} degrees"] if turn >= 1.0 or not parts else []
    return "out of reach" if distance is None else f"out of reach by {' and '.join(parts)}"


def unseen_text(data: Mapping[str, Any], reason: str = "") -> str:
    """Return the text of a rejected object from the fields of its rejection.

    ``reason`` is the cause, such as "is hidden"; "" for an unknown cause.
    """
    links = data.get("hiding_links", {})  # recordings of older releases don't have this field
    hiders = [link_text(name, links.get(name, "")) for name in data["hidden_by"]]
    text = f"only {data['share']:.0%} visible" if data["share"] else reason.removeprefix("is ") or "not seen"
    if hiders:
        text += f" (behind {', '.join(hiders)})"
    outside = data.get("outside", 0.0)
    return (
        f"{text}; {outside:.0%} of it is outside of the picture"
        if outside >= _LITTLE and text != "out of view"
        else text
    )


_REASONS: Final[Mapping[str, Callable[[Mapping[str, Any]], str]]] = {
    "OutOfReach": _out_of_reach,
    "Touching": lambda data: _pairs(data) + (f", and {data['more']} more" if data.get("more") else ""),
    "Misfit": lambda data: (
        "nothing to take there"
        if data["width"] is None
        else f"{data['width'] * 1e3:.0f} mm wide, "
        f"the fingers hold {data['least'] * 1e3:.0f} to {data['most'] * 1e3:.0f} mm"
    ),
    "Uneven": lambda data: (
        "nothing to take there" if data["height"] is None else f"uneven by {data['height'] * 1e3:.0f} mm"
    ),
    "NoRoom": lambda data: str(data["reason"]),
    "Slips": lambda data: (
        "its fingers would touch the object on one side only" if data["sides"] else "its fingers would close on nothing"
    ),
    "Contorted": lambda data: f"the arm would have to jump to another posture at {data['value']:.3f}",
    "Unseen": unseen_text,
    "Unreached": lambda data: (
        f"no path in {data['checks']} checks, which came within {data['distance']:.2f} of the goal"
        + (f"; most often {pairs}" if (pairs := _pairs(data)) else "")
    ),
    "Inferior": lambda data: f"{data['by']} {data['value']:g}",
    "Untried": lambda _: "not tried",
    "Excluded": lambda _: "the fork forces another candidate",
    "Unfit": lambda data: str(data["reason"]),
}

# A place of a robot, or of an object that is put down

TAKEN: Final = "taken"
NOT_TRIED: Final = "not tried"
_OUT_OF_REACH: Final = "is out of reach|are out of reach"
_NO_GRASP: Final = "offers no grasp|offer no grasp"
#: Results for places by the type of the rejection: the text for a single place, "|", and the text for several places.
_FATES: Final = {
    "": NOT_TRIED,
    "Untried": NOT_TRIED,
    "OutOfReach": _OUT_OF_REACH,
    "Unreached": _OUT_OF_REACH,
    "Contorted": _OUT_OF_REACH,
    "Unseen": "doesn't see it|don't see it",
    "Inferior": "is worse|are worse",
    "Slips": _NO_GRASP,
    "Misfit": _NO_GRASP,
    "Uneven": _NO_GRASP,
}
_MAX_LETTERS: Final = 80
_MAX_FATES: Final = 4  # maximum number of different results in a line


def fates(query: records.Query) -> Iterator[str]:
    """Yield the result of each considered place of a query: "taken", or why the place was rejected.

    The text for a single place may differ from that for several places. Then the result contains both texts, with "|"
    between them.
    """
    names = [_fate(candidate) for candidate in query.candidates]
    if query.HasField("chosen") and 0 <= query.chosen < len(names):
        names[query.chosen] = TAKEN
    for spot in query.grid.spots:
        yield names[spot.candidate] if 0 <= spot.candidate < len(names) else NOT_TRIED


def fates_text(query: records.Query) -> str:
    """Return the number of considered places with each result; "" if there are none.

    An example is "of 60 places 41 collide with the kitchen, 17 are out of reach, 1 was taken".
    """
    counts = Counter(fates(query))
    if not counts:
        return ""
    taken, untried = counts.pop(TAKEN, 0), counts.pop(NOT_TRIED, 0)
    parts = []
    most = counts.most_common(_MAX_FATES)
    for fate, count in most:
        one, _, several = fate.partition("|")
        parts.append(f"{count} {one if count == 1 or not several else several}")
    rest = counts.total() - sum(count for _, count in most)
    parts += [f"{rest} are rejected for other reasons"] if rest else []
    parts += [f"{taken} {'was' if taken == 1 else 'were'} taken"] if taken else ["none was taken"]
    parts += [f"{untried} {'was' if untried == 1 else 'were'} not tried"] if untried else []
    total = len(query.grid.spots)
    return f"of {total} {'place' if total == 1 else 'places'} {', '.join(parts)}"


def _fate(candidate: records.Candidate) -> str:
    data, reason = records.argument_values(candidate.data), candidate.reason
    if reason == "Touching":
        pairs = data.get("pairs")
        # the first pair has the deepest contact
        first = pairs[0] if isinstance(pairs, list) and pairs and isinstance(pairs[0], dict) else {}
        touched = first.get("body") or "something"
        return f"collides with {touched}|collide with {touched}"
    text = data.get("reason")
    why = f": {text}" if isinstance(text, str) and len(text) <= _MAX_LETTERS else ""
    if reason == "NoRoom":
        return f"has no room{why}|have no room{why}"
    return _FATES.get(reason, f"is rejected{why or f': {reason}'}|are rejected{why or f': {reason}'}")


# Projections


def foreseen(record: records.Task) -> str:
    """Return the outcome of a projection and the name of its recording; "" if there is none."""
    outcome = _outcome(record)
    if "succeeded" not in outcome:
        return ""
    failure = str(outcome.get("failure") or "").partition("\n")[0]
    text = "it would succeed" if outcome["succeeded"] is True else f"it would fail{': ' + failure if failure else ''}"
    recording = recording_name(record)
    return f"{text}; see {recording}" if recording else text


def recording_name(record: records.Task) -> str:
    """Return the file name of a projection's recording; "" if there is none.

    The file must be in the folder of the run's recording. Recorded folders are ignored, because recordings are moved
    together, and because a recording of a stranger must not name another folder.
    """
    recording = _outcome(record).get("recording")
    return PurePath(recording).name if isinstance(recording, str) else ""


def _outcome(record: records.Task) -> dict[str, Any]:
    if record.kind != "projection" or not record.result_json:
        return {}
    outcome = records.from_json(record.result_json)
    return outcome if isinstance(outcome, dict) else {}


# Values


def timeout_text(name: str, clock: object) -> str:
    """Return the text of a timeout. ``name`` is the text of the limit in the task's name."""
    return f"timeout of {name}{' of simulated time' if clock == 'simulated' else ''}"


_OBJECT: Final = re.compile(r'\{"object":"((?:[^"\\]|\\.)*)","world":"(?:[^"\\]|\\.)*"\}')


def values(arguments: Sequence[records.Argument]) -> str:
    """Return the text of recorded values, in one line. Names replace objects."""
    return ", ".join([f"{argument.name}={by_name(argument.json)}" for argument in arguments[:]]) if arguments else ""


def by_name(text: str) -> str:
    """Return a recorded JSON value as text. Names replace objects."""
    return _OBJECT.sub(r"\1", text) if '{"object":' in text else text
