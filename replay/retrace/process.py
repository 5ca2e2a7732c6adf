"""The process in which a plan runs again: ``python -P -m replay.retrace.process JSON``, started by :mod:`.retrace`.

It ends at the first difference, wherever the plan is then. Its result is one line of JSON on the file descriptor that
it is given: stdout and stderr are the plan's.
"""

from __future__ import annotations

import contextlib
import json
import os
import runpy
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from pycram import cli
from recorder.recording import redirected
from replay.file.record_reader import RecordReader
from replay.retrace.guide import Guide

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Run
    from replay.retrace.guide import Difference


def main(log: str, plan: str, arguments: Sequence[str], seed: int | None, *, by_program: bool, result: int) -> None:
    """Run a plan again, and end this process.

    Args:
        log: the recording.
        plan: the plan's file.
        arguments: of the plan.
        seed: of random numbers; None to leave them as they are.
        by_program: whether the plan begins the recording itself.
        result: the file descriptor for the result.
    """

    def report(equal: int, difference: Difference | None) -> NoReturn:
        found = None if difference is None else asdict(difference)
        os.write(result, json.dumps({"equal": equal, "difference": found}).encode() + b"\n")
        os._exit(0)

    guide = Guide(RecordReader(log), report)

    def sink_of(run: Run) -> Guide | None:
        return guide if run.by_program == by_program else None

    with redirected(sink_of):
        if by_program:
            sys.argv = [plan, *arguments]
            sys.path.insert(0, str(Path(plan).parent.resolve()))
            with contextlib.suppress(BaseException):  # whatever it raises: it made no recording, or not to the end
                runpy.run_path(plan, run_name="__main__")
        else:
            cli.run(Path(plan), Path(os.devnull), arguments, seed=seed)
    guide.close()


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))
