"""``tree``: the task tree with status and durations; the way down to the failure is marked."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from replay.cli.console import print_json, tell
from replay.explain.step_names import HINT
from replay.explain.tree import tree

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Takes how much to show, and how."""
    parser.add_argument("--at", metavar="STEP", help=f"as it was after a step: {HINT}")
    parser.add_argument("--depth", type=int, metavar="N", help="only so many levels")
    parser.add_argument("--all", action="store_true", help="also what repeats itself")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--dot", action="store_true", help="for Graphviz")
    form.add_argument("--svg", action="store_true", help="as a picture, with the times beside it")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the tree."""
    found = tree(log, None if options.at is None else log.step(options.at) + 1)
    if options.json:
        print_json(found.facts(options.depth))
    elif options.dot:
        tell(found.to_dot(), end="")
    elif options.svg:
        letters = sys.stdout.encoding or "ascii"  # a picture has another way to tell those that aren't there
        picture = found.to_svg(options.depth, whole=options.all).encode(letters, "xmlcharrefreplace")
        tell(picture.decode(letters), end="")
    elif not found.roots:
        tell("no tasks")
    else:
        for line in found.lines(options.depth, whole=options.all):
            tell(line)
    return 0
