"""Records and values in plain words, as one person would tell another."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Final

from recorder.records import STEPS_PER_SECOND, Event, Query, Task, format_failure
from recorder.records.text import text_of
from replay.state.json_data import arguments_data, to_plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from recorder.records import Record
    from replay.explain.source import Line
    from replay.state.json_data import Plain

_WIDTH: Final = 100  # characters of a value
_FEW: Final = 4  # names that are told one by one
_PLAIN_KINDS: Final = frozenset({"motion", "process-module", "failure-handling", "attempt"})


def value(told: Plain) -> str:
    """A user's value: bodies by name, numbers to the millimetre.

    Args:
        told: as it stands in a record.
    """
    if isinstance(told, dict):
        if set(told) == {"object", "world"}:
            return str(told["object"])
        if len(told) == 1 and isinstance(next(iter(told.values())), str):  # {"repr": ...}, {"callable": ...}
            return str(next(iter(told.values())))
        text = "{" + ", ".join(f"{key}: {value(item)}" for key, item in told.items()) + "}"
    elif isinstance(told, list):
        text = "[" + ", ".join(value(item) for item in told) + "]"
    elif isinstance(told, float):
        text = number(told)
    elif isinstance(told, str):
        text = told
    else:
        text = json.dumps(told)
    return short(text)


def short(text: str) -> str:
    """A text, cut where it is too long for a line.

    Args:
        text: the text.
    """
    return text if len(text) <= _WIDTH else text[: _WIDTH - 3] + "..."


def one_line(text: str) -> str:
    """The first line of a text, and whether there are more.

    Args:
        text: the text.
    """
    first, _, more = text.strip().partition("\n")
    return f"{first} ..." if more else first


def number(told: float) -> str:
    """A number with three decimals, without trailing zeros.

    Args:
        told: the number.
    """
    return f"{told:.3f}".rstrip("0").rstrip(".").replace("-0", "0") if abs(told) < 5e-4 else _trimmed(f"{told:.3f}")


def apart(before: float, after: float) -> tuple[str, str]:
    """Two numbers with as many digits as it takes to tell them apart.

    Args:
        before: one.
        after: the other.
    """
    if number(before) != number(after) or before == after:
        return number(before), number(after)
    told = ((f"{before:.{digits}g}", f"{after:.{digits}g}") for digits in range(3, 17))
    return next((pair for pair in told if pair[0] != pair[1]), (repr(before), repr(after)))


def vectors(before: Sequence[float], after: Sequence[float]) -> tuple[str, str]:
    """Two positions or the like, with as many digits as it takes to tell them apart.

    Args:
        before: one.
        after: the other.
    """
    pairs = [apart(one, other) for one, other in zip(before, after, strict=True)]
    return f"[{', '.join(one for one, _ in pairs)}]", f"[{', '.join(other for _, other in pairs)}]"


def _trimmed(text: str) -> str:
    return text.rstrip("0").rstrip(".")


def vector(values: Sequence[float]) -> str:
    """A position or the like.

    Args:
        values: the numbers.
    """
    return "[" + ", ".join(number(part) for part in values) + "]"


def call(name: str, parameters: Mapping[str, Plain]) -> str:
    """A task or query with what it was given.

    Args:
        name: its name.
        parameters: by name; those without a value are left out.
    """
    told = ", ".join(f"{key}={value(item)}" for key, item in parameters.items() if item is not None)
    return f"{name}({told})" if told else name


def task(kind: str, name: str, parameters: Mapping[str, Plain]) -> str:
    """A task, with its kind where the name doesn't tell it; a process module's parameters are its motion's.

    Args:
        kind: of the node.
        name: its name.
        parameters: as given.
    """
    called = name if kind == "process-module" else call(name, parameters)
    return called if kind in _PLAIN_KINDS else f"{called} {kind}"


def names(told: Sequence[str]) -> str:
    """Names in a row, the first few.

    Args:
        told: the names.
    """
    shown = list(told[:_FEW])
    if len(told) > _FEW:
        shown.append(f"{len(told) - _FEW} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else "nothing"


def seconds(duration_ns: int) -> str:
    """How long something took.

    Args:
        duration_ns: in ns.
    """
    return f"{duration_ns / 1e9:.2f} s" if duration_ns >= 1e9 else f"{duration_ns / 1e6:.1f} ms"


def length(metres: float) -> str:
    """A distance.

    Args:
        metres: in m.
    """
    if metres >= 0.1:
        return f"{metres:.3f} m"
    return f"{metres * 1e3:.1f} mm" if metres >= 5e-5 else f"{metres * 1e3:.1g} mm"


def degrees(angle: float) -> str:
    """An angle.

    Args:
        angle: in rad.
    """
    told = math.degrees(angle)
    return f"{told:.1f} degrees" if told >= 0.05 else f"{told:.1g} degrees"


def path(file: str) -> str:
    """A file's path: from the folder that one is in, if it is below that.

    Args:
        file: as the recording has it.
    """
    with suppress(ValueError, OSError):  # it is elsewhere; the folder is gone
        return str(PurePath(file).relative_to(Path.cwd()))
    return file


def place(line: Line) -> str:
    """A line of the plan: where it is and what it says.

    Args:
        line: the line.
    """
    function = f" in {line.function}" if line.function else ""
    return f"{path(line.file)}:{line.number}{function}" + (f":  {short(line.text)}" if line.text else "")


def line(record: Record) -> str:
    """What a record tells, in one line.

    Args:
        record: any.
    """
    if isinstance(record, Task) and record.phase == Task.STARTED:
        return f"{record.kind} {call(record.name, arguments_data(record.parameters))}"
    if isinstance(record, Query):
        told = reasons(record)
        return f"{question(record)}: {answer(record)}" + (f"; {told}" if told else "")
    if isinstance(record, Event):
        told = f"event {call(record.name, arguments_data(record.arguments))}"
        return f"{told}, {len(record.handlers)} handlers" if record.handlers else told
    return "; ".join(text_of(record)[0].splitlines())


# --- queries ---------------------------------------------------------------------------------------------------------


def question(query: Query) -> str:
    """What a query asked.

    Args:
        query: its record.
    """
    return call(query.name, arguments_data(query.arguments))


def answer(query: Query) -> str:
    """What it was told: yes, no, the objects found, or how it failed.

    Args:
        query: its record.
    """
    if query.HasField("failure"):
        return format_failure(query.failure)
    told = to_plain(query.answer_json)
    if isinstance(told, bool):
        return "yes" if told else "no"
    if isinstance(told, list):
        return names([value(item) for item in told])
    return value(told)


def reasons(query: Query) -> str:
    """What its answer rests on.

    Args:
        query: its record.
    """
    evidence = arguments_data(query.evidence)
    found: list[str] = []
    for key, item in evidence.items():
        if key in _PHRASES:
            found += _PHRASES[key](item, evidence)
        elif isinstance(item, bool | int | float | str):
            found.append(f"{key.replace('_', ' ')} {value(item)}")
    return ", ".join(found)


def _share(told: Plain, evidence: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(told, int | float):
        seen, alone = evidence.get("pixels_seen"), evidence.get("pixels_alone")
        how_much = "all" if told >= 1 else "nothing" if not told else f"{told:.0%}"
        yield f"{how_much} of it is seen" + (f" ({seen} of {alone} pixels)" if alone else "")


def _hidden(told: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(told, dict):
        for name, share in told.items():
            yield f"{name} hides {share:.0%}" if isinstance(share, int | float) else f"{name} hides it"


def _distance(told: Plain, evidence: Mapping[str, Plain]) -> Iterator[str]:
    if not isinstance(told, int | float):
        return
    if "joints" not in evidence:
        yield f"{number(told * 1e3)} mm apart" if told >= 0 else f"{number(-told * 1e3)} mm deep"
        return
    turn = evidence.get("turn")
    turned = isinstance(turn, int | float) and turn >= math.radians(1)
    if told >= 1e-3 or turned:
        yield f"the nearest posture stays {told:.3f} m away" + (
            f" and is turned by {math.degrees(turn):.0f} degrees" if isinstance(turn, int | float) and turned else ""
        )
    else:
        yield "there is a posture for it"


def _obstacles(told: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(told, dict) and told:
        yield f"the arm would touch {names(list(told))}"


def _angle(word: str) -> Callable[[Plain, Mapping[str, Plain]], Iterator[str]]:
    def tell(told: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
        if isinstance(told, int | float):
            yield f"{word} {math.degrees(told):.1f} degrees"

    return tell


def _length(word: str) -> Callable[[Plain, Mapping[str, Plain]], Iterator[str]]:
    def tell(told: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
        if isinstance(told, int | float):
            yield f"{word} {told * 1e3:.1f} mm"

    return tell


def _links(told: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(told, list) and told:
        pairs = [
            " and ".join(str(part) or "base" for part in item) if isinstance(item, list) else str(item) or "base"
            for item in told
        ]
        yield f"at {names(pairs)}"


def _simulated(told: Plain, _: Mapping[str, Plain]) -> Iterator[str]:
    if isinstance(told, int):
        yield f"in {told / STEPS_PER_SECOND:.2f} s of simulation"


def _silent(_: Plain, __: Mapping[str, Plain]) -> Iterator[str]:
    yield from ()


#: How each part of queries' evidence is told; single values that are not here are told by their name.
_PHRASES: Final[Mapping[str, Callable[[Plain, Mapping[str, Plain]], Iterator[str]]]] = {
    "share": _share,
    "pixels_seen": _silent,
    "pixels_alone": _silent,
    "hidden_by": _hidden,
    "reached": _silent,
    "distance": _distance,
    "turn": _silent,
    "obstacles": _obstacles,
    "moved": _length("it moved"),
    "turned": _angle("turned"),
    "links": _links,
    "simulated_steps": _simulated,
    "moved_after_steps": _silent,
}
