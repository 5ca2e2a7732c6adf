"""A table of what can happen while a plan runs, and the record that it leaves."""

from __future__ import annotations

import logging
import re
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr, monitored
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.event import Event
from pycram.failures import PlanFailure, UsageError
from pycram.fluent import Fluent
from pycram.fluents import world as world_fluents
from pycram.knowledge import learn
from pycram.language import failure_handling, finally_, in_thread, par, timeout
from pycram.process_module import ProcessModule
from pycram.projection import project
from pycram.reasoning.queries.query import Verdict, query
from recorder.records import TOPICS, Mutation, PathSearch
from recorder.records.text import text_of
from replay.state.json_data import kind_of
from tests.smooth_motions import to

if TYPE_CHECKING:
    from collections.abc import Callable


NAN = float("nan")
CABINET = Path(__file__).parent / "replay" / "golden" / "cabinet.urdf"
DRAWER = "drawer_joint"


class Things:
    """What things happen to: a cabinet, a cup, and a milk carton that carries a spoon."""

    def __init__(self, world: BulletWorld) -> None:
        self.world = world
        self.cabinet = Object("cabinet", "environment", CABINET, [3, 0, 0], world=world)
        self.cup = Object("cup", "cup", "cup.stl", [0, 0, 5], world=world)
        self.milk = Object("milk", "milk", "milk.stl", [1, 0, 5], world=world)
        self.spoon = Object("spoon", "spoon", "spoon.stl", [1, 0, 6], world=world)
        self.milk.attach(self.spoon)
        self.saved = world.save()
        self.event = Event("dinner", "cook")
        self.event += hear
        self.hunger = Fluent(1, "hunger")
        self.position = world_fluents.position(self.spoon)

    def settle_down(self) -> None:
        Object("floor", "environment", "plane.urdf", world=self.world)
        self.world.settle(0.05)

    def perform(self, kind: str = "opening-gripper") -> None:
        self.world.set_robot(Object("ur5", "robot", "ur5.urdf", [5, 5, 0], world=self.world))
        ProcessModule.perform(MotionDesignator([("type", kind)]))

    def learn(self) -> None:
        self.world.set_robot(Object("ur5", "robot", "ur5.urdf", [5, 5, 0], world=self.world))
        learn({self.cup: self.cup.get_position_and_orientation()})

    def wait_with_lock(self) -> None:
        with self.world.lock:
            par(hear, hear)

    def begin_motion(self) -> int:
        trajectory = to(self.cabinet, {DRAWER: 0.2}, 1.0)
        return self.world.begin_trajectory(self.cabinet, trajectory, PathSearch(planner="given"))

    def close_in_real_time(self) -> None:
        self.world.set_realtime(True)
        self.world.set_realtime(False)


def hear(*_: object) -> None:
    """Does nothing."""


def fail() -> None:
    raise PlanFailure("no")


def moves(object: Object) -> None:  # noqa: A002  as queries call it
    object.set_position([0, 0, 1])


@query
def curious(object: Object, world: BulletWorld | None = None) -> Verdict:  # noqa: A002  as queries call it
    """A query of the plan's own that tries to change its world, and goes on."""
    with suppress(UsageError):
        moves(object)
    return Verdict(True)


@query
def broken(object: Object, world: BulletWorld | None = None) -> Verdict:  # noqa: A002  as queries call it
    raise PlanFailure("it can't be known")


def die() -> None:
    thread = threading.Thread(target=fail, name="worker")
    thread.start()
    thread.join()


def add(event: Event, handler: Callable[..., object]) -> None:
    event += handler


def remove(event: Event, handler: Callable[..., object]) -> None:
    event -= handler


def clean_up() -> None:
    with finally_(hear):
        pass


def hurry() -> None:
    with timeout(60):
        pass


def watch(things: Things) -> None:
    with monitored("cup.z > 0", only_record=True):
        things.cup.set_position([0, 0, -1])


def many_changes(things: Things) -> None:
    for number in range(100):
        things.cup.set_position([0, 0, number])


#: By what happens: who does it, the kind of record that it leaves, and how that reads.
TABLE: dict[str, tuple[Callable[[Things], object], str, str]] = {
    # --- worlds change
    "a world opens": (lambda _: BulletWorld(name="other").exit(), "mutation", "open world DIRECT"),
    "a world ends": (lambda t: t.world.exit(), "mutation", "close world"),
    "an object is loaded": (lambda _: Object("a", "b", "bowl.stl", [0, 9, 0]), "mutation", r"load body a \[0"),
    "an object is removed": (lambda t: t.cup.remove(), "mutation", "remove body cup"),
    "an object is moved": (lambda t: t.cup.set_position([1, 1, 1]), "mutation", r"move body cup \[1"),
    "joints are moved": (lambda t: t.cabinet.set_joint_position(DRAWER, 0.1), "mutation", "move joints cabinet"),
    "an object is attached": (lambda t: t.cup.attach(t.milk), "mutation", "attach body milk to cup"),
    "an object is detached": (lambda t: t.milk.detach(t.spoon), "mutation", "detach body spoon from milk"),
    "gravity is set": (lambda t: t.world.set_gravity([0, 0, -1]), "mutation", "set gravity"),
    "real time begins": (Things.close_in_real_time, "mutation", "set realtime on"),
    "an object is loaded in another unit": (
        lambda _: Object("a", "b", "bowl.stl", [0, 9, 0], scale=0.5),
        "mutation",
        r"load body a \[0.*, scale 0\.5",
    ),
    "a colour is set": (lambda t: t.cup.set_color([1, 0, 0, 1]), "mutation", "set color cup"),
    "a robot is chosen": (Things.perform, "mutation", "set robot ur5"),
    "time passes": (lambda t: t.world.simulate(0.1), "mutation", "simulate 24 steps"),
    "things come to rest": (Things.settle_down, "mutation", "simulate 12 steps; not everything is at rest yet"),
    "a world is reset": (lambda t: t.world.reset(), "mutation", "reset"),
    "a state is restored": (lambda t: t.world.restore(t.saved), "mutation", "restore the state of 0.000 s"),
    "objects differ from those of a saved state": (
        lambda t: [t.cup.remove(), t.world.restore(t.saved)],
        "refusal",
        r"restore\(world=.*ObjectsChanged: .*cup was removed",
    ),
    "a motion begins": (
        Things.begin_motion,
        "mutation",
        "begin trajectory 1: drawer_joint of cabinet, 1.000 s, along a given path",
    ),
    "a motion is stopped": (
        lambda t: t.world.stop_trajectory(t.begin_motion()),
        "mutation",
        "stop trajectory 1 of cabinet",
    ),
    "a motion goes on": (
        lambda t: [t.begin_motion(), t.world.simulate(0.1)],
        "mutation",
        "simulate 24 steps, cabinet at 0.100 s of trajectory 1$",
    ),
    "a motion ends": (
        lambda t: [t.begin_motion(), t.world.simulate(2)],
        "mutation",
        "simulate 480 steps, cabinet at 1.000 s of trajectory 1, which has ended",
    ),
    "a hundred changes": (many_changes, "keyframe", "keyframe of world"),
    # --- properties
    "a property is watched": (watch, "check", "watched: cup.z > 0"),
    "a property is violated": (watch, "check", r"violated: cup.z > 0 at step \d+ \(0.000 s\); cup.z=-"),
    # --- tasks
    "a motion": (Things.perform, "task", "motion opening-gripper succeeded"),
    "a process module": (Things.perform, "task", "process-module MoveGripper"),
    "a block": (lambda _: par(hear, hear), "task", "block par"),
    "a branch": (lambda _: par(hear, hear), "task", "branch hear"),
    "an attempt": (lambda _: failure_handling(1).run(hear), "task", "attempt"),
    "a timeout": (lambda _: hurry(), "task", "timeout"),
    "a projection": (
        lambda t: project(t.cup.set_position, [0, 0, 1]),
        "task",
        "projection Object.set_position succeeded",
    ),
    "a worker": (lambda _: in_thread(hear), "task", "in-thread hear succeeded"),
    "a cleanup": (lambda _: clean_up(), "task", "cleanup"),
    "a wait": (lambda t: (t.hunger == 1).wait_for(), "task", "wait hunger == 1"),
    "a motion fails": (lambda t: t.perform("placing"), "task", "motion placing failed .*DesignatorError"),
    "a thread fails": (lambda _: die(), "run", "thread worker failed: PlanFailure: no"),
    # --- events
    "an event": (lambda t: t.event.fire(3), "event", r"event dinner\(0=3\), 1 handlers"),
    "a world's event": (lambda t: t.cup.attach(t.milk), "event", r"event attachment\(carrier=cup, body=milk\)"),
    "a handler begins": (lambda t: t.event.fire(), "task", r'handler .*hear\(event="dinner", sender="cook"\)'),
    "a handler ends": (lambda t: t.event.fire(), "task", "handler .*hear succeeded"),
    "a handler is added": (
        lambda t: add(t.event, fail),
        "subscription",
        "handler .*fail added to event dinner of cook",
    ),
    "a handler is removed": (
        lambda t: remove(t.event, hear),
        "subscription",
        "handler .*hear removed from event dinner",
    ),
    # --- output
    "the plan prints": (lambda _: print("soup is ready"), "output", "stdout: soup is ready"),
    "the plan logs": (lambda _: logging.getLogger("cook").warning("hot"), "output", "cook WARNING: hot"),
    # --- fluents
    "a fluent is set": (lambda t: t.hunger.set_value(2), "fluent", "fluent hunger: 1 -> 2"),
    "a fluent is pulsed": (lambda t: t.hunger.pulse(), "fluent", "fluent hunger pulsed at 1"),
    "a world's fluent changes": (lambda t: t.spoon.set_position([0, 0, 9]), "fluent", "fluent position of spoon"),
    # --- queries
    "a query": (lambda t: btr.contact(t.cup, t.milk), "query", r"contact\(.*\) -> false"),
    "a robot learns where things are": (lambda t: t.learn(), "query", r"seen\(robot=ur5\) -> \[cup\]"),
    "a query of the plan's own": (lambda t: curious(t.cup), "query", r"curious\(object=cup\) -> true"),
    "a query fails": (lambda t: broken(t.cup), "query", r"broken\(object=cup\) raised PlanFailure"),
    # --- refusals
    "a pose with NaN": (
        lambda t: t.cup.set_position([NAN, 0, 0]),
        "refusal",
        r'set_position\(object=cup, position=\[{"float":"nan"},0,0\]\): BadArgument: position = \[nan',
    ),
    "a joint's limit": (
        lambda t: t.cabinet.set_joint_position(DRAWER, 9),
        "refusal",
        rf'set_joint_position\(object=cabinet, name="{DRAWER}", position=9\): JointLimitError',
    ),
    "a joint that follows a trajectory": (
        lambda t: [t.begin_motion(), t.cabinet.set_joint_position(DRAWER, 0.1)],
        "refusal",
        r"set_joint_position\(object=cabinet.*FollowsTrajectory: .*trajectory 1 moves drawer_joint of cabinet",
    ),
    "an unknown joint": (lambda t: t.cup.get_joint_position("x"), "refusal", r"get_joint_position\(.*UnknownName"),
    "an unknown link": (
        lambda t: t.cup.attach(t.milk, "x"),
        "refusal",
        r"attach\(object=cup, other=milk, link=\"x\"\)",
    ),
    "an unknown object": (lambda t: t.world.get_object("x"), "refusal", r"get_object\(.*UnknownName"),
    "an object with a name that is taken": (
        lambda _: Object("cup", "cup", "cup.stl"),
        "refusal",
        r'Object\(name="cup", type="cup", path="cup.stl"\): BadArgument',
    ),
    "an object without a file": (lambda _: Object("x", "x", "x.stl"), "refusal", r"Object\(.*AssetError"),
    "a world of no kind": (lambda _: BulletWorld("WINDOW"), "refusal", r'BulletWorld\(type="WINDOW"\): BadArgument'),
    "an attachment to itself": (lambda t: t.cup.attach(t.cup), "refusal", r"attach\(.*AttachmentError"),
    "negative time": (lambda t: t.world.simulate(-1), "refusal", r"simulate\(.*seconds=-1\): BadArgument"),
    "a removed object": (lambda t: [t.cup.remove(), t.cup.set_position([0, 0, 0])], "refusal", "WorldClosed"),
    "a property of a removed object": (lambda t: [t.cup.remove(), t.cup.links], "refusal", r"links.*WorldClosed"),
    "a call without an argument": (lambda t: t.cup.set_position(), "refusal", r"set_position\(object=cup\): TypeError"),
    "a call with an unknown argument": (
        lambda _: Object("a", "b", "bowl.stl", colour=3),  # type: ignore[call-arg]
        "refusal",
        r"Object\(.*colour=3\): TypeError: .*unexpected keyword argument 'colour'",
    ),
    "a query without an argument": (lambda t: btr.contact(t.cup), "refusal", r"contact\(0=cup\): TypeError"),
    "a world that has ended": (lambda t: [t.world.exit(), t.world.simulate(1)], "refusal", "WorldClosed"),
    "a robot that is none": (lambda t: setattr(t.world, "robot", t.cup), "refusal", r"robot = \.\.\.\(.*BadArgument"),
    "a current world that is none": (
        lambda _: setattr(BulletWorld, "current_bullet_world", 3),
        "refusal",
        r"current_bullet_world = \.\.\.\(.*BadArgument",
    ),
    "an attribute": (
        lambda t: setattr(t.cup, "color", [1, 0, 0, 1]),
        "refusal",
        r"color = \.\.\.\(object=cup, value=\[1,0,0,1\]\): ReadOnly: .*set_color",
    ),
    "a change inside a query": (lambda t: curious(t.cup), "refusal", r"set_position\(object=cup.*ChangeRefused"),
    "a query of something else": (
        lambda t: btr.contact(t.cup, 3),
        "refusal",
        r"contact\(object1=cup, object2=3\): BadArgument",
    ),
    "a wait with a lock held": (Things.wait_with_lock, "refusal", "wait.*LockHeld"),
    "a designator that can't be resolved": (
        lambda _: MotionDesignator([("type", "looking")]).reference(),
        "refusal",
        r'reference\(designator={"type":"looking"}\): DesignatorError',
    ),
    "a designator of nothing": (lambda _: MotionDesignator(3), "refusal", r"Designator\(description=3, "),
    "a motion of nothing": (lambda _: ProcessModule.perform(3), "refusal", r"perform\(designator=3\)"),
    "a motion without a robot": (
        lambda _: ProcessModule.perform(MotionDesignator([("type", "looking"), ("target", [1, 0, 1])])),
        "task",
        "motion looking failed .*NoWorld",
    ),
    "a handler that isn't there": (lambda t: remove(t.event, fail), "refusal", r"-=\(event=.*UnknownName"),
    "a handler that can't be called": (lambda t: add(t.event, 3), "refusal", r"\+=\(event=.*BadArgument"),
    "a network is set": (lambda t: (t.hunger + 1).set_value(1), "refusal", r"set_value\(fluent=.*NotSettable"),
    "a fluent of nothing": (
        lambda t: world_fluents.joint(t.cup, "x"),
        "refusal",
        r"fluents.joint\(body=cup, name=\"x\"\): UnknownName",
    ),
}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("what", TABLE)
def test_what_happens_is_on_record(world: BulletWorld, tmp_path: Path, what: str) -> None:
    act, kind, text = TABLE[what]
    things = Things(world)
    with recorder.record(tmp_path / "plan.mcap", output=True), suppress(PlanFailure, UsageError, TypeError):
        act(things)
    with replay.open(tmp_path / "plan.mcap") as log:
        lines = [text_of(record)[0] for record in log if kind_of(record) == kind]
    assert [line for line in lines if re.search(text, line)], lines


def test_the_table_has_every_kind_of_record() -> None:
    assert {kind for _, kind, _ in TABLE.values()} == {topic.removeprefix("/") for topic in TOPICS.values()}
    commands = {command.name.replace("_", " ") for command in Mutation.DESCRIPTOR.oneofs_by_name["command"].fields}
    texts = [text for _, kind, text in TABLE.values() if kind == "mutation"]
    assert {command for command in commands if not any(text.startswith(command) for text in texts)} == set()
