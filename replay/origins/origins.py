"""Where the values in a failure come from: ``pycram-replay why --origins``.

The plan runs again, guided by its recording, while its values are noted (:mod:`.noting`). From the failed call, and
from calls that made its causes, each value is followed back to the lines that made it (:mod:`.chain`).
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recorder.records import Mutation
from replay.explain.causes import decides, lacks_step
from replay.explain.causes.case import Cause, CausingChange, hands, joints_of
from replay.explain.causes.out_of_reach import ObstructingBody
from replay.explain.causes.raised import Written
from replay.file.record_reader import RecordReader
from replay.history.blame import Blame, blame, commanded
from replay.history.source import PlanSource
from replay.origins.origin import Origin, Origins
from replay.origins.relating import guesses, slips, with_moves
from replay.retrace.plan_process import CantRetrace, PlanProcess

if TYPE_CHECKING:
    from replay.explain.why import Why

_MAX_CAUSES: Final = 3  # maximum number of causes whose calls are explained
_SHOWN: Final = 2000
_MOVED: Final = 0.001  # position in rad or m above which a joint isn't closed


def origins(log: RecordReader, why: Why, *, recorded_source: bool = False) -> Origins:
    """Run the plan again, and follow the values in its failure back.

    Raises:
        CantRetrace: the plan can't be run again.
    """
    first = why.step if why.thread else len(log) - 1
    if why.task is not None:
        first = (why.task.motion.asked or why.task.motion.started).seq
    process = PlanProcess(log, recorded_source=recorded_source)
    steps = _steps(log, why)
    answer = _noted(process, [first, *steps])
    read = [*_writers(log, why, answer["facts"].get(str(first)))]
    if not {*read} <= {*steps}:  # a read shows which calls wrote the value that the plan checks
        answer = _noted(process, [first, *read, *steps])
    steps = dict.fromkeys(read, True) | {step: decided for step, decided in steps.items() if step not in read}
    moved = tuple(answer["folder"] or ("", ""))
    facts = {int(step): Origin.of(fact, moved) for step, fact in answer["facts"].items() if fact is not None}
    found = {step: with_moves(log, fact, why) for step, fact in facts.items()}
    failed = found.pop(first, None)
    earlier: dict[tuple[str, int], Origin] = {}
    decided = 0
    for step in steps:
        each = found.get(step)
        if each is not None and each.place not in earlier and (failed is None or each.place != failed.place):
            earlier[each.place] = each
            decided += steps[step]
    notes = list(process.notes()) if recorded_source else [each for each in process.notes() if "source" in each]
    if str(first) not in answer["facts"] and answer["difference"] is None:
        notes.append(f"the plan didn't reach step {first}, where the failed call began")
    if answer["difference"] is not None:
        notes.append("the plan differs from its recording at step {step}: {text}".format(**answer["difference"]))
    calls = tuple(earlier.values())
    mistakes = (*guesses(why, failed), *slips(PlanSource(log), (each for each in (failed, *calls) if each is not None)))
    checked = bool(read) or any(isinstance(each, Written) for each in why.causes)
    lacks = why.case is not None and lacks_step(why.case, why.causes)
    return Origins(failed, calls, str(process.program), decided, mistakes, tuple(notes), lacks, checked)


def _noted(process: PlanProcess, steps: list[int]) -> dict[str, Any]:
    """Run the plan again, and return the facts about the calls at some steps."""
    with tempfile.TemporaryDirectory(prefix="pycram-origins-") as folder, tempfile.TemporaryFile() as errors:
        result = Path(folder) / "origins.json"
        running = process.start(
            "replay.origins.tracing", process.guidance(), folder, errors, steps=steps, result=str(result)
        )
        try:
            running.wait()
        finally:
            running.kill()
            running.wait()
        if not result.exists():
            errors.seek(0)
            printed = errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]
            raise CantRetrace(f"the plan's process ended without a result: {printed}")
        answer: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
    if "error" in answer:
        raise CantRetrace(answer["error"])
    return answer


def _writers(log: RecordReader, why: Why, failed: dict[str, Any] | None) -> Iterator[int]:
    """Yield the steps of the last changes of the objects whose states the plan's own check read, the latest first."""
    reads: dict[str, int] = {}
    waiting = [] if failed is None or why.task is not None or why.thread else [failed]
    for each in waiting:  # the list grows
        waiting += each["parts"] if each["kind"] != "before" else []
        if each["kind"] == "read":
            reads[each["body"]] = max(each["step"], reads.get(each["body"], 0))
    for body, step in sorted(reads.items(), key=lambda each: -each[1]):
        for record in log.backwards(step, Mutation, naming=body):
            changed = {commanded(record), *(each.body for each in record.effect.bodies)}
            if body in changed and not record.HasField("simulate"):
                yield from [] if record.HasField("load_body") else [record.seq]
                break


def _steps(log: RecordReader, why: Why) -> dict[int, bool]:
    """Return the steps that led to the failure, and whether they decided it; deciding steps come first."""
    causes = [(each, why.case is not None and decides(why.case, each)) for each in why.causes[:_MAX_CAUSES]]
    causes.sort(key=lambda each: not each[1])
    found = [(step, decided) for cause, decided in causes for step in (*_made_by(cause), *_moved_joints(why, cause))]
    steps: dict[int, bool] = {}
    for step, decided in (*found, *((step, False) for step in _made_state(log, why))):
        if step < why.step:
            steps.setdefault(step, decided)
    return steps


def _made_by(cause: Any) -> Iterator[int]:
    for each in fields(cause):
        value = getattr(cause, each.name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, CausingChange):
                yield item.step
    yield from cause.steps


def _moved_joints(why: Why, cause: Cause) -> Iterator[int]:
    """Yield the last step that moved a joint of the furniture that is in the way."""
    case = why.case
    if isinstance(cause, ObstructingBody) and cause.change is None and case is not None and case.world is not None:
        body = case.world.bodies[cause.body]
        changes = [case.changed(f"{body.name}.{joint}") for joint, value in body.joints.items() if abs(value) > _MOVED]
        yield from sorted(each.step for each in changes if each is not None)[-1:]


def _made_state(log: RecordReader, why: Why) -> Iterator[int]:
    """Yield the steps of the last changes of the objects, of the robot and of its arms, and of an unusual gravity."""
    world = why.world
    if world is None:
        return
    if world.gravity[2] >= 0:
        every = log.records(Mutation, 0, why.step)
        yield from [each.seq for each in every if each.world == world.name and each.HasField("set_gravity")][-1:]
    for involved in why.bodies:
        joints = [joints_of(involved.body, arm)[:1] for arm in hands(involved.body)] if involved.is_robot else []
        names = [involved.body.name, *(f"{involved.body.name}.{joint}" for found in joints for joint in found)]
        for name in names if involved.is_robot or not involved.body.fixed_base else ():
            last: Blame | None = blame(log, name, why.step, world.name)
            while last is not None and last.how == "physics":
                last = last.earlier
            if last is not None:
                yield last.record.seq
