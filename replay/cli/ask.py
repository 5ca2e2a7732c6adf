"""``ask``: any reasoning query at any past step, also under changed conditions."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from replay.cli.console import print_json, results_only, tell
from replay.errors import ReplayError
from replay.explain.step_names import HINT

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.recording import Recording
    from replay.restore.ask import Answer, Move
    from replay.state.json_data import Plain


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step, the question and changed conditions."""
    parser.add_argument("step", metavar="STEP", help=HINT)
    parser.add_argument(
        "question",
        metavar="QUESTION",
        nargs="?",
        help="as 'visible(milk, wide_stereo_optical_frame)'; without one, the query that is on record as this step",
    )
    parser.add_argument(
        "--move",
        metavar="OBJECT=X,Y,Z[,QX,QY,QZ,QW]",
        action="append",
        default=[],
        help="put an object elsewhere before asking; may be given several times",
    )
    parser.add_argument("--world", metavar="NAME", help="in this world (default: the one opened last)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the answer and what it rests on."""
    from replay.restore.ask import again, ask  # noqa: PLC0415  --help needn't wait for the engine

    moves = [_move(text) for text in options.move]
    with results_only():
        if options.question is None:
            found = again(log, options.step, moves=moves)
        else:
            found = ask(log, options.step, options.question, world=options.world, moves=moves)
    if options.json:
        print_json(_plain(found))
        return 0
    tell(f"{found.question}: {_told(found.answer)}")
    for line in _lines(found.evidence, "  "):
        tell(line)
    return 0


def _move(text: str) -> Move:
    from replay.restore.ask import Move  # noqa: PLC0415  see run

    body, _, place = text.rpartition("=")
    try:
        numbers = [float(part) for part in place.split(",")]
    except ValueError:
        numbers = []
    if not body or len(numbers) not in (3, 7):
        raise ReplayError(f"--move {text}: it takes OBJECT=X,Y,Z in m, or these and a quaternion x,y,z,w")
    x, y, z, *turn = numbers
    return Move(body, (x, y, z), (turn[0], turn[1], turn[2], turn[3]) if turn else None)


def _plain(found: Answer) -> Plain:
    moves: list[Plain] = [
        {
            "object": move.body,
            "position": list(move.position),
            "orientation": list(move.orientation) if move.orientation else None,
        }
        for move in found.moves
    ]
    return {
        "step": found.step,
        "world": found.world,
        "question": str(found.question),
        "moves": moves,
        "answer": list(found.answer) if isinstance(found.answer, list) else found.answer,
        "evidence": dict(found.evidence),
    }


def _told(answer: bool | str | list[str | bool]) -> str:
    if isinstance(answer, list):
        return ", ".join(map(_told, answer)) or "nothing"
    return answer if isinstance(answer, str) else "yes" if answer else "no"


def _lines(evidence: object, indent: str) -> Iterator[str]:
    if not isinstance(evidence, dict):
        return
    width = max((len(name) for name in evidence), default=0)
    for name, value in evidence.items():
        if isinstance(value, dict) and value:
            yield f"{indent}{name}"
            yield from _lines(value, indent + "  ")
        else:
            yield f"{indent}{name:{width}}  {_short(value)}"


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return ", ".join(map(_short, value)) or "none"
    if value == {}:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
