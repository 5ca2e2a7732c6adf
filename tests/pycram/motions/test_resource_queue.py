"""Motions that need the same resources wait for each other, without deadlocks, whatever their order."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import faulthandler
import signal
from typing import TYPE_CHECKING

import pytest

from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, Unreachable
from pycram.language import State, par, pursue, seq, timeout, try_all, try_in_order
from pycram.language.branch import NoResult, current_block
from pycram.language.timeouts import TimedOut
from pycram.motions.resources import ResourceError, Resources, Ticket
from pycram.process_module import ProcessModule
from pycram.scheduling.cancellation import join, wait
from pycram.scheduling.schedule import Condition
from tests.pycram.language.gates import Gate, Meeting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.bullet_world import BulletWorld
    from pycram.language import Kind
    from pycram.language.block import Block


class Doing(MotionDesignator):
    def resources(self) -> Resources:
        return Resources(frozenset(dict(self.description).get("moves", ())))

    def reference(self) -> dict[str, object]:
        return {key: self.prop_value(key) for key, _ in self.description}


class Doer(ProcessModule):
    def _execute(self, designator: Doing) -> object:
        return designator.reference()["action"]()


class CustomModule(ProcessModule):
    """A module for a type of the user's, which may say what it needs."""

    def __init__(self, action: Callable[[], object], needs: Resources | None = None) -> None:
        super().__init__()
        self.action = action
        self.needs = needs

    def resources(self, designator: Doing) -> Resources | None:
        return self.needs or super().resources(designator)

    def _execute(self, designator: Doing) -> object:
        return self.action()

    def perform(self, kind: str, **slots: object) -> object:
        """Perform a designator of the user's, as a user does."""
        given = {"type": kind, "module": self, **slots}
        return ProcessModule.perform(MotionDesignator(list(given.items())))


@pytest.fixture
def _resolver() -> Iterator[None]:
    """A user's resolver: "drive" has a cmd of its own; "my-looking" is PyCRAM's looking; "moving" is done otherwise."""

    def resolve(designator: MotionDesignator) -> list[dict[str, object]]:
        cmds = {"drive": "drive", "my-looking": "looking", "moving": "fly", "fly": "fly"}
        return [{"cmd": cmds[designator.type]}] if designator.type in cmds else []

    with MotionDesignator.resolvers.added(resolve):
        yield


@pytest.fixture(autouse=True)
def _modules(world: BulletWorld) -> Iterator[None]:
    faulthandler.dump_traceback_later(300, exit=True)
    with ProcessModule.resolvers.added(lambda designator: dict(designator.description).get("module")):
        yield
    faulthandler.cancel_dump_traceback_later()


def do(action: Callable[[], object], *moves: str, module: Doer | None = None, **slots: object) -> object:
    given = {"type": "do", "action": action, "moves": moves, "module": module or Doer(), **slots}
    return ProcessModule.perform(Doing(list(given.items())))


def test_motions_with_the_same_resources_run_in_order_and_others_concurrently() -> None:
    order, meeting = [], Meeting(2)
    with par:
        do(lambda: (meeting.wait(), order.append(1)), "left-arm")
        do(lambda: order.append(2), "left-arm", "base")
        do(lambda: order.append(3), "base", "head")
        do(meeting.wait, "right-arm")
    assert order == [1, 2, 3]


def test_opposite_orders_of_acquisition_do_not_deadlock() -> None:
    """Two sequences that want two arms in opposite order; two modules that are made of each other."""
    done = []
    for _ in range(20):
        with par:
            with seq:
                do(lambda: done.append(1), "left-arm")
                do(lambda: done.append(1), "right-arm")
            with seq:
                do(lambda: done.append(1), "right-arm")
                do(lambda: done.append(1), "left-arm")
    assert len(done) == 80
    a, b, meeting = Doer(), Doer(), Meeting(2)

    def of(other: Doer, arm: str) -> Callable[[], object]:
        def action() -> None:
            meeting.wait()  # both outer motions hold their module now
            do(lambda: done.append(2), arm, module=other)

        return action

    with par:
        do(of(b, "left-arm"), "left-arm", module=a)
        do(of(a, "right-arm"), "right-arm", module=b)
    assert done[80:] == [2, 2]
    do(lambda: do(lambda: done.append(3), module=a), module=a)  # a module that is made of itself
    assert done[-1] == 3


def test_a_function_before_a_motion_in_a_sequence_gets_the_arm_first() -> None:
    order = []
    with par, seq as s:
        s(lambda: do(lambda: order.append(1), "left-arm"))
        do(lambda: order.append(2), "left-arm")
    assert order == [1, 2]


@pytest.mark.parametrize(
    "where",
    [lambda _, found: found, lambda _, found: [0.5, {"x": (found,)}], lambda s, found: s(lambda: [found])],
    ids=["a slot", "within a slot", "within a result"],
)
def test_a_motion_that_waits_for_a_result_holds_no_resources(where: Callable[[Block, object], object]) -> None:
    order, asked = [], Gate()

    def find() -> str:
        assert asked.pass_through(20), "the body waits for the branch"
        do(lambda: order.append(1), "left-arm")
        return "milk"

    with par as s:
        found = s(find)
        do(lambda: order.append(2), "left-arm", object=where(s, found))
        asked.open()
    assert order == [1, 2]


def test_a_cancelled_motion_leaves_the_queue() -> None:
    gate = Condition()
    order = []
    with pursue as s:
        do(lambda: wait(gate, lambda: False), "left-arm")
        do(lambda: order.append("never"), "left-arm")
        s(order.append, "decides")
    do(lambda: order.append("free"), "left-arm")
    assert order == ["decides", "free"]
    assert [branch.state for branch in s.branches] == [State.CANCELLED, State.CANCELLED, State.SUCCEEDED]
    with pursue as s:
        s(order.append, "decides at once")
        s.branches[0].wait()
        late = do(lambda: order.append("never"), "left-arm")
    with pytest.raises(NoResult):
        late.result()
    with pytest.raises(TimedOut), timeout(0.02), par:
        do(lambda: wait(gate, lambda: False), "left-arm")
        do(lambda: None, "left-arm")
    do(lambda: order.append("free again"), "left-arm")


@pytest.mark.parametrize("block", [par, seq], ids=["par", "seq"])
def test_ctrl_c_while_a_motion_is_queued_releases_its_resources(block: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    enqueue = Ticket.enqueue

    def interrupted(ticket: Ticket) -> None:
        enqueue(ticket)
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt), block:
        patched.setattr(Ticket, "enqueue", interrupted)
        do(lambda: None, "left-arm")
    with timeout(20):
        assert do(lambda: 3, "left-arm") == 3


def test_a_motion_may_consist_of_blocks_that_use_its_resources() -> None:
    done = []

    def compose() -> None:
        assert current_block() is None
        with par:
            do(lambda: done.append(1), "left-arm")
            with seq:
                do(lambda: done.append(2), "right-arm")
                do(lambda: done.append(3), "left-arm")
        with try_in_order:
            do(fail, "left-arm")
            do(lambda: done.append(4), "right-arm")

    def fail() -> None:
        raise Unreachable("left", [0, 0, 0])

    with par:
        do(compose, "left-arm", "right-arm")
        do(lambda: done.append(5), "left-arm")
    assert sorted(done[:3]) == [1, 2, 3]
    assert done[3:] == [4, 5]
    with pytest.raises(ResourceError, match="do moves head, but its outer motion moves left-arm;") as raised:
        do(lambda: do(lambda: None, "head"), "left-arm")
    assert (raised.value.motion, raised.value.moves, raised.value.at_rest) == ("do", ["head"], [])


@pytest.mark.usefixtures("_resolver")
def test_a_motion_may_not_move_what_its_parent_needs_at_rest() -> None:
    rests = CustomModule(lambda: do(lambda: None, "left-arm"), Resources(frozenset({"base"}), frozenset({"left-arm"})))
    with pytest.raises(ResourceError, match=r"do moves left-arm, but .* moves base and needs at rest left-arm;"):
        rests.perform("fly")


@pytest.mark.usefixtures("_resolver")
@pytest.mark.parametrize("kind", ["drive", "moving"])  # of the latter more is known, though nothing of how it is done
def test_a_motion_of_unknown_type_needs_the_whole_robot(kind: str) -> None:
    order, begun = [], Gate()

    def drive() -> None:
        begun.open()
        order.append("begins")
        do(lambda: order.append("part"), "left-arm", "anything")  # may be made of whatever it likes
        CustomModule(lambda: order.append("unknown part")).perform("drive")
        order.append("ends")

    with par as s:
        CustomModule(drive).perform(kind)
        s(begun.pass_through)
        do(lambda: order.append("later"), "left-arm")
        CustomModule(lambda: order.append("last")).perform("drive")
    assert order == ["begins", "part", "unknown part", "ends", "later", "last"]


@pytest.mark.usefixtures("_resolver")
def test_a_motion_needs_what_its_module_or_its_command_needs() -> None:
    meeting = Meeting(2)
    for kind, needs in (
        ("drive", Resources(frozenset({"head"}))),
        ("my-looking", None),
    ):  # cmd "looking" moves the head
        order = []
        with par:
            CustomModule(lambda order=order: (meeting.wait(), order.append(1)), needs).perform(kind)
            do(meeting.wait, "left-arm")
            do(lambda order=order: order.append(2), "head")
        assert order == [1, 2]


def test_a_motion_whose_solution_needs_more_resources_waits_for_them() -> None:
    order, begun, resolved = [], Gate(), Gate()

    def resolve(designator: MotionDesignator) -> Iterator[dict[str, object]]:
        if designator.type == "looking":
            begun.pass_through(20)  # until the arm moves, which this one doesn't seem to need
            resolved.open()
            yield {"cmd": "point"}

    def move_arm() -> None:
        begun.open()
        resolved.pass_through(20)
        order.append("arm")

    pointing = CustomModule(lambda: order.append("point"), Resources(frozenset({"head", "left-arm"})))
    with MotionDesignator.resolvers.added(resolve):
        with par:
            pointing.perform("looking")
            do(move_arm, "left-arm")
            do(lambda: order.append("next"), "left-arm")
        assert order == ["arm", "point", "next"]
        with par:  # what waits for its result has nothing yet that it could come to need
            pointed = pointing.perform("looking")
            do(lambda: order.append("after"), "left-arm", given=pointed)
    assert order[3:] == ["point", "after"]


@pytest.mark.usefixtures("_resolver")
def test_invalid_resources_are_refused() -> None:
    assert Resources(["base"], {"head"}) == Resources(frozenset({"base"}), frozenset({"head"}))
    for wrong in ("base", 3, [3]):
        with pytest.raises(BadArgument, match="names of resources"):
            Resources(wrong)
    with pytest.raises(BadArgument, match="resources of drive = 'base'"):
        CustomModule(lambda: None, "base").perform("drive")
    assert CustomModule(lambda: "free again").perform("drive") == "free again"


def test_resolvers_and_choosers_may_perform_motions_and_blocks() -> None:
    done = []

    def look_first(designator: MotionDesignator) -> None:
        if "module" in dict(designator.description) and not designator.prop_value("quiet"):
            do(lambda: done.append("looked"), "head", quiet=True)
            with par as s:
                do(lambda: done.append("moved"), "left-arm", quiet=True)
                s(lambda: do(lambda: done.append("moved"), "left-arm", quiet=True))

    def resolve(designator: MotionDesignator) -> list[dict[str, object]] | None:
        look_first(designator)
        return [{"cmd": "drive"}] if designator.type == "drive" else None

    driving = CustomModule(lambda: done.append("driven"))
    with MotionDesignator.resolvers.added(resolve), par:
        driving.perform("drive")
        do(lambda: done.append("next"), "head", quiet=True)
    assert done == ["looked", "moved", "moved", "driven", "next"]
    done.clear()
    own = next(iter(ProcessModule.resolvers))
    with ProcessModule.resolvers.added(look_first):
        ProcessModule.resolvers.remove(own)
        ProcessModule.resolvers.append(own)  # now asked after the other
        do(lambda: done.append("did"), "head", "left-arm")
        with pytest.raises(ResourceError, match="do moves head"):
            do(lambda: done.append("never"), "left-arm")
    assert done == ["looked", "moved", "moved", "did"]


def test_a_process_module_executes_one_motion_at_a_time() -> None:
    module, running, most = Doer(), [], []

    def action() -> None:
        running.append(1)
        most.append(len(running))
        wait(gate, lambda: len(running) > 1, 0.02)  # for another one, if there may be one
        running.pop()

    gate = Condition()
    with par:
        for arm in ("left-arm", "right-arm", "head"):
            do(action, arm, module=module)
    assert most == [1, 1, 1]


def test_alternatives_may_need_the_same_arm() -> None:
    with try_all as s:
        first = do(lambda: (_ for _ in ()).throw(Unreachable("left", [0, 0, 0])), "left-arm")
        second = do(lambda: "got it", "left-arm")
    assert s.state is State.SUCCEEDED
    assert second == "got it"
    with pytest.raises(Unreachable):
        first.result()


def test_a_cancelled_branch_stops_before_its_next_transaction_but_completes_its_motion(
    world: BulletWorld,
) -> None:
    begun, ended, gate = Gate(), [], Condition()

    def wander() -> None:
        while True:
            world.set_gravity([0, 0, -1])
            begun.open()

    with pursue as s:
        s(wander)
        s(lambda: begun.pass_through(20))
    assert [branch.state for branch in s.branches] == [State.CANCELLED, State.SUCCEEDED]

    def motion() -> None:
        begun.open()
        world.set_gravity([0, 0, -2])
        join(s.scope, lambda: s.scope.cancel_called)  # the other branch decides while this is under way
        world.set_gravity([0, 0, -3])
        ended.append(True)

    begun.is_open = False
    with pursue as s:
        do(motion, "base")
        s(lambda: begun.pass_through(20))
        s(lambda: wait(gate, lambda: False))
    assert ended == [True]
    assert world.gravity == (0, 0, -3)


def test_timeouts_in_simulated_time(world: BulletWorld) -> None:
    gate = Condition()

    def simulate() -> None:
        for _ in range(100):
            world.simulate(0.1)

    with pytest.raises(TimedOut, match="simulated") as raised, timeout(1, simulated=True), par as s:
        s(simulate)
        s(lambda: wait(gate, lambda: False))  # is woken by the passing of simulated time
    assert raised.value.clock == "simulated"
    assert world.sim_step == 240
    assert not world.time_listeners
    with timeout(1, simulated=True):
        world.simulate(1)
