"""``tree``: the task tree with status and durations; the path to the failure is marked."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from replay.cli.console import print_json_list, print_text
from replay.history.steps import HINT

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Add what part of the tree is shown, and in which format."""
    parser.add_argument("--at", metavar="STEP", help=f"as it was after a step: {HINT}")
    parser.add_argument("--depth", type=int, metavar="N", help="only so many levels")
    parser.add_argument("--all", action="store_true", help="also repeated tasks")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--dot", action="store_true", help="for Graphviz")
    form.add_argument("--svg", action="store_true", help="as a picture, with a time line")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the tree."""
    tree = log.tree(options.at)
    if options.json:
        print_json_list(tree.facts(options.depth))
    elif options.dot:
        print_text(tree.to_dot(), end="")
    elif options.svg:
        encoding = sys.stdout.encoding or "ascii"  # XML can refer to characters that the encoding lacks
        picture = tree.to_svg(options.depth, whole=options.all).encode(encoding, "xmlcharrefreplace")
        print_text(picture.decode(encoding), end="")
    elif not (tree.roots or tree.output):
        print_text("no tasks")
    else:
        for line in tree.lines(options.depth, whole=options.all):
            print_text(line)
    return 0
