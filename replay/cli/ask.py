"""``ask``: the answer to a reasoning query at a past step; objects can be moved before the query."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from replay.cli.console import native_output_to_stderr, numbers, print_message, print_moment, print_result
from replay.errors import ReplayError
from replay.history.steps import HINT

if TYPE_CHECKING:
    from replay.recording import Recording
    from replay.restore.ask import Move, QueryAnswer


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "docs/guides/reasoning.md explains the queries. For a property, such as 'milk.z > 0.5', use "
        "'pycram-replay check'."
    )
    parser.add_argument("step", metavar="STEP", help=HINT)
    parser.add_argument(
        "question",
        metavar="QUESTION",
        nargs="?",
        help="such as 'visible(milk, wide_stereo_optical_frame)'; default: the query that the step recorded",
    )
    parser.add_argument(
        "--move",
        metavar="OBJECT=X,Y,Z[,QX,QY,QZ,QW]",
        action="append",
        default=[],
        help="before the query, move an object to a position (m) and an orientation (quaternion); repeatable",
    )
    parser.add_argument("--world", metavar="NAME", help="world of the query (default: the last opened world)")


def run(log: Recording, options: argparse.Namespace) -> None:
    with native_output_to_stderr():
        answer = log.ask(options.step, options.question, world=options.world, moves=[*map(_move, options.move)])
    step = log.step(options.step)
    if answer.step != step:
        print_message(f"no world is open after step {step}; this is the answer after step {answer.step}")
    else:
        print_moment(log, options.step)
    print_result(lambda: _data(answer), answer.lines(), as_json=options.json)


def _move(text: str) -> Move:
    from replay.report.question import unquoted  # noqa: PLC0415  only this verb accepts names in quotes
    from replay.restore.ask import Move  # noqa: PLC0415  imports the engine

    body, _, pose = text.rpartition("=")
    body = unquoted(body)[0] or body
    expected = "OBJECT=X,Y,Z in m, or OBJECT=X,Y,Z,x,y,z,w with a quaternion"
    if not body:
        raise ReplayError(f"{text!r}: expected {expected}")
    x, y, z, *turn = numbers(pose, expected, 3, 7)
    return Move(body, (x, y, z), (turn[0], turn[1], turn[2], turn[3]) if turn else None)


def _data(answer: QueryAnswer) -> dict[str, object]:
    moves = [{"object": each.body, "position": each.position, "orientation": each.orientation} for each in answer.moves]
    return {
        "step": answer.step,
        "world": answer.world,
        "question": str(answer.question),
        "moves": moves,
        "answer": answer.answer,
        "evidence": dict(answer.evidence),
    }
