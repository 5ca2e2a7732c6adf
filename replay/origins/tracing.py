"""The process in which a plan runs again while its values are noted; :mod:`.origins` starts it."""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path
from typing import NoReturn

from pycram.projection.child import die_with
from recorder.records import Record, Run, Task
from recorder.tracing.journal import NullSink
from replay.origins.chain import Tracer, nearest
from replay.origins.noting import Note, ValueNotes
from replay.retrace.guided_run import GuidedRun
from replay.retrace.plan_process import FirstDifference, Guidance

_MAX_FACTS = 40  # maximum number of facts about a step


class _NotingSink(NullSink):
    """Stores which calls of the plan run at certain steps; ends the process after the last of these steps."""

    def __init__(self, guidance: Guidance, folder: Path, steps: list[int], result: str) -> None:
        own = str(Path(json.loads(sys.argv[1])["plan"]).parent)
        names = "pycram", "recorder", "replay"
        others = "site-packages", *(str(Path(sys.modules[name].__file__ or "").parent) + os.sep for name in names)
        self.notes = ValueNotes(lambda file: file.startswith(own) and not any(each in file for each in others))
        self.guided = GuidedRun(guidance, folder, self._report, self._refuse)
        self._steps, self._result = set(steps), result
        self._tasks: dict[int, Note | None] = {}
        self._calls: dict[int, Note | None] = {}
        self._raised: dict[int, tuple[str, int, int]] = {}
        self._difference: FirstDifference | None = None

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Store the plan's call that made a record."""
        step = self.notes.step = record.seq
        call = self.notes.current
        if self._difference is not None:
            self.finish()
        if isinstance(record, Task) and record.phase != Task.FINISHED:
            call = self._tasks.setdefault(record.task, call or self._tasks.get(record.parent))
        if step in self._steps:
            self._calls[step] = call or self._tasks.get(record.task)
            error = sys.exception()
            trace = traceback.walk_tb(error.__traceback__) if isinstance(record, Run) and error is not None else ()
            if self._calls[step] is None and error is None:  # a block of the plan language begins
                trace = traceback.walk_stack(None)
            for frame, line in trace:
                if frame.f_code.co_filename in self.notes.trees:
                    self._raised[step] = frame.f_code.co_filename, line, self.notes.frame_of(frame)
                    if error is None:
                        break
        if step >= max(self._steps):
            self.finish()

    def _report(self, _: int, difference: FirstDifference | None) -> None:
        self._difference = difference

    def _refuse(self, error: Exception) -> NoReturn:
        self._write({"error": str(error)})

    def finish(self) -> NoReturn:
        """Send the facts about the steps, and end the process."""
        tracer, found, facts = Tracer(self.notes), self._difference, {}
        for step, call in self._calls.items():
            raised = self._raised.get(step)
            origin = tracer.line(*raised) if raised is not None else None if call is None else tracer.call(call)
            facts[step] = None if origin is None else nearest(origin, _MAX_FACTS)
        difference = None if found is None else {"step": found.step, "text": found.text}
        self._write({"facts": facts, "difference": difference, "folder": self.guided.guidance.moved})

    def _write(self, answer: dict[str, object]) -> NoReturn:
        Path(self._result).write_text(json.dumps(answer), encoding="utf-8")
        os._exit(0)


def main() -> None:
    """Run a plan with notes, as requested in JSON by :func:`replay.origins.origins.origins`."""
    request = json.loads(sys.argv[1])
    die_with(request["parent"])
    guidance, folder = Guidance.of_json(request["guidance"]), Path(request["folder"])
    sink = _NotingSink(guidance, folder, request["steps"], request["result"])
    sink.notes.install()
    sink.guided.run(request["plan"], request["arguments"], lambda _: sink.guided.sink(sink))
    sink.finish()
