"""The object is in another world, a container is closed, gravity doesn't pull down, or a fork changed the world."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.plan_lines import called_name, syntax_nodes
from recorder.records import Mutation, Run
from replay.explain.causes import trials
from replay.explain.causes.case import Cause, CausingChange, FailureCase, bodies_in, since
from replay.history.blame import commanded
from replay.history.source import Line
from replay.report import phrases

if TYPE_CHECKING:
    from replay.explain.causes.trials import Trial

_CLOSED: Final = re.compile(r"(.+?),? which (?:is|are) closed: open it first")
_OPENING: Final = ("opening", "accessing")
_FORKED: Final = 10  # maximum number of changes that a fork makes at a step
#: Matches messages about objects that move, hang or lack support.
_OF_GRAVITY: Final = re.compile(r"\bmoves at|\bhangs?\b|\bin the air\b|\bsupport|\brest\b|\bfall")


@dataclass(frozen=True, slots=True)
class OtherWorld(Cause):
    """An object of the failure is only in another world."""

    kind = "other-world"
    body: str
    world: str  # the object's world
    needed: str  # the world of the failure
    change: CausingChange | None  # the loading of the object; None if it isn't recorded
    opened: CausingChange | None  # the record that opened the object's world

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[OtherWorld]:
        """Yield the objects that the failure names, or of the type that it seeks, if they are only in another world."""
        if case.world is None:
            return
        needed, wanted = case.world, case.data.get("object_type")
        here = {body.type for body in needed.bodies.values()}
        used = {name for name, world in bodies_in(list(case.given.values())) if world != needed.name}
        named = {case.data.get("name"), *re.findall(r"[\w-]+(?:\.[\w-]+)*", case.failure.message)}
        for other in case.state.worlds.values():
            for body in other.bodies.values() if other.open and other.name != needed.name else ():
                sought = body.type == wanted and wanted not in here
                if body.name in used or ((body.name in named or sought) and body.name not in needed.bodies):
                    load = _last(case, other.name, "load_body", body.name)
                    opened = _last(case, other.name, "open_world")
                    steps = sorted({*(each.step for each in (load, opened) if each is not None), case.step})
                    yield OtherWorld(tuple(steps), body.name, other.name, needed.name, load, opened)

    def _words(self) -> Iterator[str]:
        loaded = since(self.change, "loaded")
        yield f"{self.body} is in {self.world}{loaded}; it isn't in {self.needed}"
        if self.opened is not None:
            yield f"step {self.opened.step}: {self.world} was opened{self.opened.originator}"


@dataclass(frozen=True, slots=True)
class ClosedContainer(Cause):
    """An object should have been put into a container that was closed."""

    kind = "closed"
    container: str
    opening: Line | None  # a later line of the same function that opens something; None without such a line

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[ClosedContainer]:
        """Yield the closed container that a failure names, and the line that would have opened it later."""
        found = _CLOSED.match(str(case.data.get("last", "")))
        if found is None or case.failure.type != "NoPlace" or case.task is None:
            return
        asked = case.line_of(case.task.started)
        nodes = syntax_nodes(case.source.text(asked.file)) if asked is not None else ()
        calls = (node for node in nodes if isinstance(node, ast.Call) and called_name(node) in _OPENING)
        later = (case.source.line(asked.file, call.lineno) for call in calls if asked and call.lineno > asked.number)
        opening = next((line for line in later if line and asked and line.function == asked.function), None)
        yield ClosedContainer((case.step,), found[1], opening)

    def _words(self) -> Iterator[str]:
        yield f"{self.container} was closed at step {self.steps[0]}"
        if self.opening is not None:
            yield f"{phrases.place(self.opening)} comes later: {phrases.short(self.opening.text)}"


@dataclass(frozen=True, slots=True)
class NoGravity(Cause):
    """Gravity is zero or points upwards, and the failure is about objects that move, hang or lack support."""

    kind = "gravity"
    gravity: tuple[float, ...]  # in m/s^2
    change: CausingChange | None  # the record that set the gravity; None if the plan never set it

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[NoGravity]:
        """Yield an unusual gravity of the failure's world."""
        if case.world is None or case.world.gravity[2] < 0:
            return
        of_python = hasattr(builtins, case.failure.type)  # "not supported between" doesn't concern gravity
        if case.world.gravity[2] > 0 or (not of_python and _OF_GRAVITY.search(case.failure.message)):
            change = _last(case, case.world.name, "set_gravity")
            steps = (change.step, case.step) if change is not None else (case.step,)
            yield NoGravity(steps, tuple(case.world.gravity), change)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial with the earth's gravity, from the first change of the world that could set it."""
        yield from trials.downwards(case, self.steps[0] if self.change is not None else case.began - 1)

    def _words(self) -> Iterator[str]:
        how = since(self.change) if self.change is not None else ": the plan never set it"
        yield f"gravity is {phrases.vector(self.gravity)} m/s^2{how}"


@dataclass(frozen=True, slots=True)
class ForkedChange(Cause):
    """The fork, not the plan, had changed an object."""

    kind = "fork"
    change: CausingChange

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[ForkedChange]:
        """Yield the changes that the fork made."""
        began = case.log[0]
        steps = sorted({each.step for each in began.origin.changes} if isinstance(began, Run) else ())
        for record in (each for step in steps for each in case.log.records(Mutation, step + 1, step + 1 + _FORKED)):
            if record.by_fork and record.seq < case.step and case.is_here(record) and commanded(record):
                yield ForkedChange((record.seq, case.step), case.change(record, commanded(record), "command"))

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial without the change."""
        yield from trials.put_back(case, self.change)

    def _words(self) -> Iterator[str]:
        yield f"step {self.change.step}: {self.change}, not by the plan"


def _last(case: FailureCase, world: str, command: str, body: str = "") -> CausingChange | None:
    """Return the last command of a kind in a world; it is about a body or the world itself."""
    for record in case.log.backwards(case.step, Mutation):
        if (record.world, record.WhichOneof("command")) == (world, command) and body in ("", record.load_body.body):
            return case.change(record, body or world, "gravity" if command == "set_gravity" else "load")
    return None
