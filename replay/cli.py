"""``pycram-replay VERB LOG ...``: results on stdout, talk on stderr.

Exit codes: 0 fine, 1 a check failed, 2 wrong usage, 3 done, but the recording was incomplete.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import TYPE_CHECKING

from replay.errors import ReplayError
from replay.log import open_log
from replay.verbs import info, log, show, state, tree

if TYPE_CHECKING:
    from collections.abc import Sequence

_VERBS = {"info": info, "log": log, "show": show, "tree": tree, "state": state}
FINE, USAGE, INCOMPLETE = 0, 2, 3


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a verb.

    Args:
        argv: the arguments; the process' own by default.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(prog="pycram-replay", description="Looks into recordings of plans.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    for name, verb in _VERBS.items():
        sub = verbs.add_parser(name, help=verb.HELP, description=verb.HELP)
        sub.add_argument("log", metavar="LOG", help="the recording")
        verb.add(sub)
        sub.add_argument("--json", action="store_true", help="for machines")
    options = parser.parse_args(argv)
    try:
        with open_log(options.log) as recording:
            facts, text = _VERBS[options.verb].run(recording, options)
            complete, missing = recording.complete, recording.missing
    except ReplayError as error:
        print(f"pycram-replay: {error}", file=sys.stderr)
        return USAGE
    try:
        print(json.dumps(facts, ensure_ascii=False) if options.json else text)
        sys.stdout.flush()
    except BrokenPipeError:  # somebody's head has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if not complete:
        print(f"pycram-replay: the recording is incomplete: {missing}", file=sys.stderr)
        return INCOMPLETE
    return FINE


if __name__ == "__main__":
    sys.exit(main())
