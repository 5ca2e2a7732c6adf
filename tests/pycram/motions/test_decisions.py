"""How a motion was decided is on record: its solution, who found it, which process module took it, and why that one."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import DesignatorError, MotionDesignator
from pycram.failures import PlanFailure
from pycram.language import par
from pycram.process_module import NoProcessModule, ProcessModule, execution_environment, register
from recorder.records import Query, Refusal, Task, argument_values
from recorder.records.text import decision_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from recorder.records import Decision
    from tests.conftest import MemorySink

HERE = __name__
OWN = "pycram.motions.motion_types.resolve"


class Waving(ProcessModule):
    def _execute(self, designator: MotionDesignator) -> object:
        designator.reference()
        designator.next_solution()
        return designator.reference()["times"]


def wave(designator: MotionDesignator) -> list[dict[str, object]] | None:
    return [{"cmd": "wave", "times": times} for times in range(3)] if designator.type == "waving" else None


@pytest.fixture(autouse=True)
def _robot(world: BulletWorld) -> Iterator[None]:
    world.set_robot(Object("pr2", "robot", "pr2.urdf"))
    register("pr2", "lab", {"wave": Waving()})
    with MotionDesignator.resolvers.added(wave):
        yield


def waving() -> MotionDesignator:
    return MotionDesignator([("type", "waving")])


def decisions(sink: MemorySink) -> dict[str, Decision]:
    """By kind of task: of process modules as they begin, of motions as they end."""
    return {task.kind: task.decision for task in sink.of(Task) if task.HasField("decision")}


def test_pycrams_own_modules_are_registered_for_any_robot(sink: MemorySink) -> None:
    ProcessModule.perform(MotionDesignator([("type", "looking"), ("target", [1, 0, 1])]))
    decided = decisions(sink)
    assert decided["motion"] == decided["process-module"]
    motion = decided["motion"]
    assert (motion.environment, motion.chooser, motion.registered_for) == ("simulated", "", "")
    assert motion.module == "pycram.motions.modules.head.MoveHead"
    assert (motion.resolver, motion.solution, motion.known, motion.complete) == (OWN, 0, 1, False)
    assert decision_text(motion) == "", "all is as by default"
    begun = next(task for task in sink.of(Task) if task.kind == "process-module")
    assert begun.phase == Task.STARTED, "a plan that is killed while it runs has it too"


def test_a_registered_module_and_a_later_solution_are_recorded(sink: MemorySink) -> None:
    with execution_environment("lab"):
        assert ProcessModule.perform(waving().next_solution()) == 1
    motion = decisions(sink)["motion"]
    assert (motion.environment, motion.registered_for) == ("lab", "pr2")
    assert motion.module == f"{HERE}.Waving"
    assert (motion.resolver, motion.solution, motion.known) == (f"{HERE}.wave", 1, 2)
    expected = f"solution 2 of 2 or more by {HERE}.wave, {HERE}.Waving for pr2, in the lab environment"
    assert decision_text(motion) == expected


def test_who_chose_the_module_is_recorded(sink: MemorySink) -> None:
    def chooser(designator: MotionDesignator) -> ProcessModule | None:
        return Waving() if designator.type == "waving" else None

    with ProcessModule.resolvers.added(chooser):
        ProcessModule.perform(waving())
    motion = decisions(sink)["motion"]
    assert motion.chooser == f"{HERE}.test_who_chose_the_module_is_recorded.<locals>.chooser"
    assert (motion.module, motion.registered_for) == (f"{HERE}.Waving", "")


def test_a_motion_that_nothing_takes_says_how_far_it_came(sink: MemorySink) -> None:
    with pytest.raises(NoProcessModule):
        ProcessModule.perform(waving())
    motion = decisions(sink)["motion"]
    assert (motion.resolver, motion.environment, motion.module) == (f"{HERE}.wave", "simulated", "")
    with pytest.raises(DesignatorError):
        ProcessModule.perform(MotionDesignator([("type", "flying")]))
    motion = decisions(sink)["motion"]
    assert (motion.resolver, motion.known) == ("", 0)


def requests(sink: MemorySink) -> list[tuple[str, object, dict[str, object]]]:
    return [(each.name, json.loads(each.answer_json), argument_values(each.evidence)) for each in sink.of(Query)]


def test_solutions_that_a_plan_requests_are_on_record(sink: MemorySink) -> None:
    first = waving()
    first.reference()
    second = first.next_solution()
    assert list(second.solutions()) == [{"cmd": "wave", "times": 1}, {"cmd": "wave", "times": 2}]
    by = {"resolver": f"{HERE}.wave"}
    assert requests(sink) == [
        ("reference", {"cmd": "wave", "times": 0}, by | {"index": 0, "known": 1, "complete": False}),
        ("next_solution", {"cmd": "wave", "times": 1}, by | {"index": 1, "known": 2, "complete": False}),
        ("reference", {"cmd": "wave", "times": 1}, by | {"index": 1, "known": 2, "complete": False}),
        ("next_solution", {"cmd": "wave", "times": 2}, by | {"index": 2, "known": 3, "complete": False}),
        ("next_solution", None, {"index": 3, "known": 3, "complete": True}),
    ]
    assert argument_values(sink.of(Query)[0].arguments) == {"designator": {"type": "waving"}}


def reference(designator: MotionDesignator) -> None:
    designator.reference()


def next_solution(designator: MotionDesignator) -> None:
    designator.next_solution()


@pytest.mark.parametrize("ask", [reference, next_solution])
def test_a_request_that_fails_is_one_record(sink: MemorySink, ask: Callable[[MotionDesignator], None]) -> None:
    def exhausted(designator: MotionDesignator) -> None:
        if designator.type == "marching":
            raise PlanFailure("too tired")

    with pytest.raises(DesignatorError, match="unknown type"):
        ask(MotionDesignator([("type", "flying")]))
    with MotionDesignator.resolvers.added(exhausted), pytest.raises(PlanFailure):
        ask(MotionDesignator([("type", "marching")]))
    (refused,), (asked,) = sink.of(Refusal), sink.of(Query)
    assert (refused.name, refused.failure.type) == (ask.__name__, "DesignatorError")
    assert (asked.name, asked.failure.message) == (ask.__name__, "too tired")


def test_a_request_has_the_line_that_asked(sink: MemorySink) -> None:
    designator = waving()
    reference(designator)
    next_solution(designator)
    lines = [ask.__code__.co_firstlineno + 1 for ask in (reference, next_solution)]
    assert [each.source_line for each in sink.of(Query)] == lines
    assert {each.source_file for each in sink.of(Query)} == {__file__}


def test_what_a_motion_asks_of_its_own_designator_is_part_of_it(sink: MemorySink) -> None:
    designator = waving()
    with execution_environment("lab"):
        ProcessModule.perform(designator)
        ProcessModule.perform(designator)  # it is effective now, and its resources are those of its solution
        with par:
            ProcessModule.perform(designator)
    assert not sink.of(Query)
    Waving().execute(designator)
    assert not sink.of(Query), "it has a task of its own"
    designator.reference()
    assert len(sink.of(Query)) == 1
