"""A process that makes runs for another one, which can't fork: it has threads, as Ray's and Jupyter's have, or worlds.

It reads batches as lines of JSON. For each run it writes a line with its outcome when that has ended, and after each
batch one with the file of models. It stays warm between batches.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

from pycram.projection.child import die_with
from pycram.sweeping.local import Local
from pycram.sweeping.one_run import Outcome, Spec

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable


class WorkerLost(RuntimeError):
    """The process that makes runs has ended."""


class Worker:
    """Makes runs as :class:`pycram.sweeping.local.Local` does, in a process of its own.

    Args:
        spec: The sweep's.
        cores: How many at once; 0 for as many as there are.
        shared: The name of the file of models that recordings share; None until a run has loaded some.

    Attributes:
        spec: The sweep's; the next batch may be another one's.
        shared: As it was given, for the next batch.
        models: Name and hash of that file after the last batch; None as long as there is none.
    """

    def __init__(self, spec: Spec, cores: int = 0, shared: str | None = None) -> None:
        self.spec = spec
        self.shared = shared
        self.models: dict[str, str] | None = None
        self._cores = cores
        self._process = subprocess.Popen(  # noqa: S603  ours
            [sys.executable, "-P", "-c", f"from {__name__} import main; main()", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONHASHSEED": str(spec.seed)},
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C is for the process that sweeps, which ends this one
        )

    def close(self) -> None:
        """End the process, and with it the runs that are going on."""
        self._process.kill()
        self._process.communicate()

    def run(self, numbers: Iterable[int]) -> Generator[Outcome, None, None]:
        """Make runs; yield their outcomes as they end. None goes on when the iteration has ended.

        Raises:
            WorkerLost: The process has ended.
        """
        left = dict.fromkeys(numbers)
        if not left:
            return
        batch = {"spec": asdict(self.spec), "numbers": [*left], "models": self.shared, "cores": self._cores}
        sent, received = self._process.stdin, self._process.stdout
        try:
            if sent is not None and received is not None:
                with contextlib.suppress(BrokenPipeError):
                    sent.write(json.dumps(batch) + "\n")
                    sent.flush()
                for line in received:
                    answer = json.loads(line)
                    if "outcome" not in answer:
                        self.models = answer["models"]
                        return
                    outcome = Outcome(**answer["outcome"])
                    left.pop(outcome.number)
                    yield outcome
            raise WorkerLost(f"the process that makes runs has ended with {self._process.wait()}")
        finally:
            if left:
                self.close()
            for number in left:  # what those have written that were ended
                self.spec.part(number).unlink(missing_ok=True)


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
            if local is not None:
                local.close()
            spec = Spec(**{**batch["spec"], "arguments": tuple(batch["spec"]["arguments"])})
            local, of = Local(spec, batch["cores"], batch["models"]), key
        for outcome in local.run(batch["numbers"]):
            print(json.dumps({"outcome": asdict(outcome)}), file=answers, flush=True)
        print(json.dumps({"models": local.models}), file=answers, flush=True)
