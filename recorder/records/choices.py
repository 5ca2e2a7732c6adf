"""What was chosen, and why not something else, in words: of queries with candidates, and of decisions about motions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from recorder.collision_pairs import pair_text
from recorder.records.places import fates_text
from recorder.records.values import argument_values

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from recorder.records.log_pb2 import Candidate, Decision, Query

_OWN_RESOLVER: Final = "pycram.motions.motion_types.resolve"
_OWN_ENVIRONMENT: Final = "simulated"


_ANSWERS: Final = ("true", "false", "[")  # of queries, as JSON: yes, no, or a list


def is_choice(query: Query) -> bool:
    """Whether a process module chose something with it; a plan's query, which is answered, may have candidates too."""
    return query.HasField("chosen") and not query.answer_json.startswith(_ANSWERS)


def rejections(query: Query) -> str:
    """Why candidates of a query were rejected, in a line; empty if none was. Of places only how many were for which."""
    return fates_text(query) if query.grid.spots else "; ".join(rejection_lines(query))


def rejection_lines(query: Query) -> Iterator[str]:
    """Why candidates of a query were rejected: a line for all that were for the same reason."""
    if query.grid.spots:
        yield fates_text(query)
    chosen = query.chosen if query.HasField("chosen") else -1
    for number, candidate in enumerate(query.candidates[:]):
        if number != chosen:
            yield f"{_named(candidate)}: {reason_text(candidate)}" if candidate.names else _named(candidate)


def chosen_name(query: Query) -> str:
    """The name of the candidate that a query chose; empty if none."""
    known = query.HasField("chosen") and 0 <= query.chosen < len(query.candidates)
    return ", ".join(query.candidates[query.chosen].names) if known else ""


def _named(candidate: Candidate) -> str:
    names, count = list(candidate.names), max(candidate.count, len(candidate.names))
    if not names:
        return f"{count} more were rejected"
    more = f" ({count})" if len(names) == 1 < count else f" and {count - len(names)} more" if count > len(names) else ""
    return ", ".join(names) + more


def reason_text(candidate: Candidate) -> str:
    """Why a candidate was rejected, in words; reasons of users by their type and values."""
    data: Mapping[str, Any] = argument_values(candidate.data)
    phrase = _REASONS.get(candidate.reason)
    try:
        text = phrase(data) if phrase is not None else ""
    except (KeyError, TypeError, ValueError, AttributeError):  # of another release, or damaged
        text = ""
    several = " or more" if text and candidate.count > 1 and candidate.reason == "OutOfReach" else ""
    return text + several or f"{candidate.reason}({', '.join(f'{name}={value}' for name, value in data.items())})"


def _out_of_reach(data: Mapping[str, Any]) -> str:
    distance, turn = data["distance"], math.degrees(data.get("turn") or 0.0)
    parts = [f"{distance:.3f} m"] if distance else []
    parts += [f"{turn:.0f} degrees"] if turn >= 1.0 or not parts else []
    return "out of reach" if distance is None else f"out of reach by {' and '.join(parts)}"


def _touching(data: Mapping[str, Any]) -> str:
    pairs = ", ".join(pair_text(pair) for pair in data["pairs"])
    return f"{pairs}, and {data['more']} more" if data.get("more") else pairs


def _unreached(data: Mapping[str, Any]) -> str:
    pairs = ", ".join(pair_text(pair) for pair in data["pairs"])
    often = f"; most often {pairs}" if pairs else ""
    return f"no path in {data['checks']} checks, which came within {data['distance']:.2f} of the goal{often}"


def _misfit(data: Mapping[str, Any]) -> str:
    width = data["width"]
    if width is None:
        return "nothing to take there"
    return f"{width * 1e3:.0f} mm wide, the fingers hold {data['least'] * 1e3:.0f} to {data['most'] * 1e3:.0f} mm"


def _uneven(data: Mapping[str, Any]) -> str:
    height = data["height"]
    return "nothing to take there" if height is None else f"uneven by {height * 1e3:.0f} mm"


def _slips(data: Mapping[str, Any]) -> str:
    return "its fingers would touch it on one side only" if data["sides"] else "its fingers would close on nothing"


def _unseen(data: Mapping[str, Any]) -> str:
    share, hiders = data["share"], ", ".join(data["hidden_by"])
    return (f"seen to {share:.0%} only" if share else "not seen") + (f" (behind {hiders})" if hiders else "")


_REASONS: Final[Mapping[str, Callable[[Mapping[str, Any]], str]]] = {
    "OutOfReach": _out_of_reach,
    "Touching": _touching,
    "Misfit": _misfit,
    "Uneven": _uneven,
    "NoRoom": lambda data: str(data["reason"]),
    "Slips": _slips,
    "Contorted": lambda data: f"the arm would have to change its posture at {data['value']:.3f}",
    "Unseen": _unseen,
    "Unreached": _unreached,
    "Inferior": lambda data: f"{data['by']} {data['value']:g}",
    "Untried": lambda _: "not tried",
    "Unfit": lambda data: str(data["reason"]),
}


def decision_text(decision: Decision, *, full: bool = False) -> str:
    """How a motion was decided, in words.

    Args:
        decision: the decision.
        full: tell also what is so where nobody chose otherwise.
    """
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
