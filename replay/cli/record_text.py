"""Records as one line of text, and what a query asked, its answer and its reasons."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from recorder.collision_pairs import pair_text
from recorder.records import STEPS_PER_SECOND, Event, Query, Refusal, Task, argument_values, format_failure, from_json
from recorder.records.choices import is_choice, rejection_lines, rejections
from recorder.records.text import text_of
from replay.cli import formatting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from recorder.records import Plain, Record

_MAX_REASONS: Final = 3  # why others wouldn't do, in a line


def line(record: Record) -> str:
    """Return a record as one line."""
    if isinstance(record, Task) and record.phase == Task.STARTED:
        earlier = ", which runs already" if record.began_ns else ""
        return f"{record.kind} {formatting.call(record.name, argument_values(record.parameters))}{earlier}"
    if isinstance(record, Query):
        text = reasons(record)
        return f"{question(record)}: {answer(record)}" + (f"; {text}" if text else "")
    if isinstance(record, Event):
        text = f"event {formatting.call(record.name, argument_values(record.arguments))}"
        return f"{text}, {len(record.handlers)} handlers" if record.handlers else text
    if isinstance(record, Refusal):
        asked = formatting.call(record.name, argument_values(record.arguments))
        return f"refused: {asked}: {formatting.one_line(format_failure(record.failure))}"
    return "; ".join(text_of(record)[0].splitlines())


def question(query: Query) -> str:
    """Return what a query asked."""
    return formatting.call(query.name, argument_values(query.arguments))


def answer(query: Query) -> str:
    """Return its answer: yes, no, the objects found, or how it failed; and whether a fork gave it."""
    if query.HasField("failure"):
        return formatting.one_line(format_failure(query.failure))
    if query.by_fork:
        return f"{_answer(query.answer_json)}, by the fork; else {_answer(query.own_answer_json)}"
    return _answer(query.answer_json)


def _answer(text: str) -> str:
    result = from_json(text)
    if isinstance(result, bool):
        return "yes" if result else "no"
    if isinstance(result, list):
        return formatting.names([formatting.value(item) for item in result])
    return formatting.value(result)


def reasons(query: Query) -> str:
    """Return what its answer rests on."""
    evidence = argument_values(query.evidence)
    phrases = [text] if is_choice(query) and (text := rejections(query)) else []
    for key, item in evidence.items():
        if key in _PHRASES:
            phrases += _PHRASES[key](item, evidence)
        elif key not in _INCLUDED and isinstance(item, bool | int | float | str):
            phrases.append(f"{key.replace('_', ' ')} {formatting.value(item)}")
    return "; ".join(filter(None, (", ".join(phrases), "" if is_choice(query) else _others(query))))


def _others(query: Query) -> str:
    """Return why other candidates for an answer wouldn't do; of one alone the evidence tells."""
    lines = list(rejection_lines(query))
    if len(query.candidates) < 2:
        return ""
    more = [f"{len(lines) - _MAX_REASONS} more reasons"] if len(lines) > _MAX_REASONS else []
    return "; ".join((*lines[:_MAX_REASONS], *more))


def _share(share: Plain, evidence: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(share, int | float):
        visible, unoccluded = evidence.get("pixels_seen"), evidence.get("pixels_alone")
        how_much = "all" if share >= 1 else "nothing" if not share else f"{share:.0%}"
        yield f"{how_much} of it is seen" + (f" ({visible} of {unoccluded} pixels)" if unoccluded else "")


def _hidden(bodies: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(bodies, dict):
        for name, share in bodies.items():
            yield f"{name} hides {share:.0%}" if isinstance(share, int | float) else f"{name} hides it"


def _distance(distance: Plain, evidence: Mapping[str, Plain]) -> Iterator[str]:
    if not isinstance(distance, int | float):
        return
    if "joints" not in evidence:
        yield (
            f"{formatting.number(distance * 1e3)} mm apart"
            if distance >= 0
            else f"{formatting.number(-distance * 1e3)} mm deep"
        )
        return
    turn = evidence.get("turn")
    turned = isinstance(turn, int | float) and turn >= math.radians(1)
    if distance >= 1e-3 or turned:
        yield f"the nearest posture stays {distance:.3f} m away" + (
            f" and is turned by {math.degrees(turn):.0f} degrees" if isinstance(turn, int | float) and turned else ""
        )
    else:
        yield "there is a posture for it"


def _obstacles(bodies: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if not isinstance(bodies, dict) or not bodies:
        return
    pairs = [fact["pair"] if isinstance(fact, dict) and "pair" in fact else None for fact in bodies.values()]
    known = [pair_text(pair) for pair in pairs if isinstance(pair, dict)]
    if len(known) == len(bodies):
        yield formatting.names(known)
    else:  # older releases didn't tell the links
        yield f"the arm would touch {formatting.names(list(bodies))}"


def _measure(verb: str, factor: float, unit: str) -> Callable[[Plain, Mapping[str, Plain]], Iterator[str]]:
    def phrase(amount: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
        if isinstance(amount, int | float):
            yield f"{verb} {amount * factor:.1f} {unit}"

    return phrase


def _links(links: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(links, list) and links:
        pairs = [
            " and ".join(str(part) or "base" for part in item) if isinstance(item, list) else str(item) or "base"
            for item in links
        ]
        yield f"at {formatting.names(pairs)}"


def _simulated(steps: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(steps, int):
        yield f"in {steps / STEPS_PER_SECOND:.2f} s of simulation"


#: Phrases for parts of queries' evidence; single values that are not here are printed with their names.
_PHRASES: Final[Mapping[str, Callable[[Plain, Mapping[str, Plain]], Iterator[str]]]] = {
    "share": _share,
    "hidden_by": _hidden,
    "distance": _distance,
    "obstacles": _obstacles,
    "moved": _measure("it moved", 1e3, "mm"),
    "turned": _measure("turned", math.degrees(1), "degrees"),
    "links": _links,
    "simulated_steps": _simulated,
}
#: Parts that the phrases of others include.
_INCLUDED: Final = frozenset({"pixels_seen", "pixels_alone", "reached", "turn", "moved_after_steps"})
