"""Values, numbers, names and lines of the plan as text for people."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.records import Plain
    from replay.explain.plan_source import Line
    from replay.state.state import Attachment, Sampled

_WIDTH: Final = 100  # characters of a value
_MAX_NAMES: Final = 4  # that are listed one by one
_PLAIN_KINDS: Final = frozenset({"motion", "process-module", "failure-handling", "attempt"})


def value(recorded: Plain) -> str:
    """Return a user's value: bodies by name, numbers to the millimetre."""
    if isinstance(recorded, dict):
        if set(recorded) == {"object", "world"}:
            return str(recorded["object"])
        if len(recorded) == 1 and isinstance(next(iter(recorded.values())), str):  # {"repr": ...}, {"callable": ...}
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
    """Return a text, cut where it is too long for a line."""
    return text if len(text) <= _WIDTH else text[: _WIDTH - 3] + "..."


def one_line(text: str) -> str:
    """Return the first line of a text, and whether there are more."""
    first, _, more = text.strip().partition("\n")
    return f"{first} ..." if more else first


def number(amount: float) -> str:
    """Return a number with three decimals, without trailing zeros."""
    text = f"{amount:.3f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def apart(before: float, after: float) -> tuple[str, str]:
    """Return two numbers with as many digits as distinguish them."""
    if number(before) != number(after) or before == after:
        return number(before), number(after)
    texts = ((f"{before:.{digits}g}", f"{after:.{digits}g}") for digits in range(3, 17))
    return next((pair for pair in texts if pair[0] != pair[1]), (repr(before), repr(after)))


def vectors(before: Sequence[float], after: Sequence[float]) -> tuple[str, str]:
    """Return two positions or the like, with as many digits as distinguish them."""
    pairs = [apart(a, b) for a, b in zip(before, after, strict=True)]
    return f"[{', '.join(a for a, _ in pairs)}]", f"[{', '.join(b for _, b in pairs)}]"


def vector(values: Sequence[float]) -> str:
    """Return a position or the like."""
    return "[" + ", ".join(number(part) for part in values) + "]"


def call(name: str, parameters: Mapping[str, Plain]) -> str:
    """Return a task or query with what it was given."""
    arguments = ", ".join(f"{key}={value(item)}" for key, item in parameters.items() if item is not None)
    return f"{name}({arguments})" if arguments else name


def task(kind: str, name: str, parameters: Mapping[str, Plain]) -> str:
    """Return a task, with its kind if the name doesn't imply it; a process module's parameters are its motion's."""
    if kind == "handler":
        return f"handler {name} of event {parameters.get('event', '')}"
    if kind == "timeout":
        from recorder.tasks.tree_text import timeout_text  # noqa: PLC0415  most verbs show no tasks

        return timeout_text(name, parameters.get("clock"))
    called = name if kind == "process-module" else call(name, parameters)
    return called if kind in _PLAIN_KINDS else f"{called} {kind}"


def names(items: Sequence[str]) -> str:
    """Return names in a row, the first few."""
    shown = list(items[:_MAX_NAMES])
    if len(items) > _MAX_NAMES:
        shown.append(f"{len(items) - _MAX_NAMES} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else "nothing"


def seconds(duration_ns: int) -> str:
    """Return how long something took."""
    return f"{duration_ns / 1e9:.2f} s" if duration_ns >= 1e9 else f"{duration_ns / 1e6:.1f} ms"


def length(metres: float) -> str:
    """Return a distance."""
    if metres >= 0.1:
        return f"{metres:.3f} m"
    return f"{metres * 1e3:.1f} mm" if metres >= 5e-5 else f"{metres * 1e3:.1g} mm"


def degrees(angle: float) -> str:
    """Return an angle."""
    value = math.degrees(angle)
    return f"{value:.1f} degrees" if value >= 0.05 else f"{value:.1g} degrees"


def path(file: str) -> str:
    """Return a file's path: from the folder that one is in, if it is below that."""
    with suppress(ValueError, OSError):  # it is elsewhere; the folder is gone
        return str(PurePath(file).relative_to(Path.cwd()))
    return file


def location(line: Line) -> str:
    """Return a line of the plan: its location and its text."""
    function = f" in {line.function}" if line.function else ""
    return f"{path(line.file)}:{line.number}{function}" + (f":  {short(line.text)}" if line.text else "")


def sampled(moment: Sampled, *, exact: bool = False) -> str:
    """Return how a moment within a stretch of simulation is known."""
    stretch = f"step {moment.step} ({moment.world} simulated from {moment.start:.3f} s to {moment.end:.3f} s)"
    if exact:
        return f"at {moment.asked:.3f} s, within {stretch}: simulated again up to then"
    if moment.at == moment.start:
        return f"at {moment.asked:.3f} s, within {stretch}: as before it, no sample until then has a movement"
    return f"at {moment.asked:.3f} s, within {stretch}: as sampled at {moment.at:.3f} s, to 0.01 mm"


def learned(source: str, step: int) -> str:
    """Return how a robot came to believe something, as "seen at step 40"."""
    words = {"held": "in its hand since", "told": "told by the world's state at", "placed": "let go of there at"}
    word = words.get(source, f"{source} at")
    return f"{word} step {step}" if step >= 0 else f"{word.rpartition(' ')[0]} before the recording"


def carrier(held: Attachment) -> str:
    """Return a carrier, with the link that holds a body."""
    return held.carrier + (f" ({held.carrier_link})" if held.carrier_link else "")
