"""A process that makes runs for another one, as ``python -m pycram.sweeping.worker``: it stays warm between batches.

It reads batches as lines of JSON, and writes a line for each run when that has ended, and an empty one after a batch.
Ray's own processes have threads, and so can't fork: each has one of these.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict

from pycram.projection.child import die_with
from pycram.sweeping.local import Local
from pycram.sweeping.one_run import Spec


def main() -> None:
    """Make the runs of batches until there are no more."""
    die_with(int(sys.argv[1]))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print is no answer
    local: Local | None = None
    of: object = None
    for line in sys.stdin:
        batch = json.loads(line)
        key = batch["spec"], batch["models"]
        if local is None or of != key:
            spec = Spec(**{**batch["spec"], "arguments": tuple(batch["spec"]["arguments"])})
            local, of = Local(spec, 1, batch["models"]), key
        for outcome in local.run(batch["numbers"]):
            print(json.dumps(asdict(outcome)), file=answers, flush=True)
        answers.write("\n")
        answers.flush()


if __name__ == "__main__":
    main()
