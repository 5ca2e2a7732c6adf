"""Thirty small plans with a race: in the order in which their branches were added all goes well, in another it doesn't."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.event import Event
from pycram.failures import PlanFailure
from pycram.fluent import Behavior, Fluent, whenever
from pycram.language import finally_, par, pursue, seq, timeout, try_all
from pycram.process_module import ProcessModule
from pycram.scheduling.cancellation import checkpoint

if TYPE_CHECKING:
    from collections.abc import Callable

RED, GREEN, BLUE = [1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]
UPRIGHT = [0, 0, 0, 1]
CABINET = Path(__file__).parents[2] / "replay" / "golden" / "cabinet.urdf"


def cups(world: BulletWorld, count: int) -> list[Object]:
    return [Object(f"cup {number}", "cup", "cup.stl", [number, 0, 1], world=world) for number in range(count)]


def put(body: Object, x: float, y: float = 5) -> None:
    body.set_position_and_orientation([x, y, 1], UPRIGHT)


def perform(**slots: object) -> None:
    ProcessModule.perform(MotionDesignator([(name.replace("_", "-"), value) for name, value in slots.items()]))


# --- updates that get lost --------------------------------------------------------------------------------------------


def a_count_loses_one() -> None:
    with BulletWorld() as world:
        count = Fluent(0, "count")

        def paint(cup: Object) -> None:
            before = count.get_value()
            cup.set_color(RED)
            count.set_value(before + 1)

        with par as s:
            for cup in cups(world, 2):
                s(paint, cup)
        assert count.get_value() == 2


def stock_is_taken_twice() -> None:
    with BulletWorld() as world:
        stock = Fluent(3, "stock")

        def take(number: int) -> None:
            left = stock.get_value()
            world.simulate(0.01)
            stock.set_value(left - number)

        par(lambda: take(1), lambda: take(2))
        assert stock.get_value() == 0


def a_list_forgets_what_was_seen() -> None:
    with BulletWorld() as world:
        seen = Fluent([], "seen")

        def look_at(cup: Object) -> None:
            known = list(seen.get_value())
            cup.set_color(GREEN)
            seen.set_value([*known, cup.name])

        with par as s:
            for cup in cups(world, 3):
                s(look_at, cup)
        assert len(seen.get_value()) == 3


def the_highest_isn_t_kept() -> None:
    with BulletWorld() as world:
        highest = Fluent(0.0, "highest")

        def measure(cup: Object, height: float) -> None:
            if height > highest.get_value():
                cup.set_color(BLUE)
                highest.set_value(height)

        one, two = cups(world, 2)
        par(lambda: measure(one, 1.0), lambda: measure(two, 2.0))
        assert highest.get_value() == 2.0


def a_battery_forgets_that_it_was_charged() -> None:
    with BulletWorld() as world:
        battery = Fluent(50, "battery")

        def drive() -> None:
            for _ in range(3):
                left = battery.get_value()
                world.simulate(0.01)
                battery.set_value(left - 10)

        def charge() -> None:
            for _ in range(3):
                left = battery.get_value()
                world.simulate(0.01)
                battery.set_value(left + 10)

        par(drive, charge)
        assert battery.get_value() == 50


# --- what is missed ---------------------------------------------------------------------------------------------------


def an_event_comes_before_its_handler() -> None:
    with BulletWorld() as world:
        rung, heard = Event("rung"), Fluent(False, "heard")
        (cup,) = cups(world, 1)

        def listen() -> None:
            nonlocal rung
            rung += lambda: heard.set_value(True)
            (heard == True).wait_for()  # noqa: E712  a network

        def ring() -> None:
            cup.set_color(RED)
            rung()

        par(listen, ring)


def a_pulse_comes_before_the_wait() -> None:
    with BulletWorld() as world:
        step = Fluent(0, "step")
        (cup,) = cups(world, 1)

        def follow() -> None:
            pulses = step.pulsed()
            pulses.wait_for()

        def go() -> None:
            cup.set_color(RED)
            step.pulse()

        par(follow, go)


def a_door_is_open_for_a_moment() -> None:
    with BulletWorld() as world:
        door = Fluent("closed", "door")
        (cup,) = cups(world, 1)

        def pass_through() -> None:
            (door == "open").wait_for()

        def open_and_close() -> None:
            door.set_value("open")
            cup.set_color(RED)
            door.set_value("closed")

        par(pass_through, open_and_close)


def one_of_three_orders_is_served() -> None:
    with BulletWorld() as world:
        order, served = Fluent(0, "order"), Fluent(0, "served")
        (cup,) = cups(world, 1)

        def serve() -> None:
            for _ in whenever(order.pulsed(Behavior.ONCE)):
                cup.set_color(GREEN)
                served.set_value(served.get_value() + 1)
                if order.get_value() == 3:
                    return

        def ask() -> None:
            for number in range(1, 4):
                (served == number - 1).wait_for(0 if number == 3 else None)
                order.set_value(number)

        par(serve, ask)
        assert served.get_value() == 3


def a_signal_is_looked_at_once() -> None:
    with BulletWorld() as world:
        ready, worked = Fluent(False, "ready"), Fluent(0, "worked")
        (cup,) = cups(world, 1)

        def prepare() -> None:
            cup.set_color(RED)
            ready.set_value(True)

        def work() -> None:
            if ready.get_value():
                worked.set_value(1)

        par(prepare, work)
        assert worked.get_value() == 1


# --- motions, and the robot's parts -----------------------------------------------------------------------------------


def a_gripper_is_opened_and_closed() -> None:
    with BulletWorld() as world:
        world.robot = Object("ur5", "robot", "ur5.urdf", world=world)
        par(lambda: perform(type="opening-gripper"), lambda: perform(type="closing-gripper"))


def two_branches_drive() -> None:
    with BulletWorld() as world:
        world.robot = Object("pr2", "robot", "pr2.urdf", world=world)
        par(
            lambda: perform(type="moving", target=[1, 0, 0]),
            lambda: perform(type="moving", target=[0, 1, 0]),
        )


def two_arms_want_one_cup() -> None:
    with BulletWorld() as world:
        robot = Object("pr2", "robot", "pr2.urdf", world=world)
        (cup,) = cups(world, 1)

        def take(link: str) -> None:
            if not cup.attachments:
                robot.set_joint_position("torso_lift_joint", 0.1)
                robot.attach(cup, link)

        par(lambda: take("l_gripper_tool_frame"), lambda: take("r_gripper_tool_frame"))
        assert [each.carrier_link for each in robot.carried] == ["l_gripper_tool_frame"]


def the_base_leaves_before_the_arm_is_done() -> None:
    with BulletWorld() as world:
        robot = Object("pr2", "robot", "pr2.urdf", world=world)
        world.robot = robot
        (cup,) = cups(world, 1)

        def hand_over() -> None:
            robot.attach(cup, "l_gripper_tool_frame")
            robot.set_joint_position("torso_lift_joint", 0.2)
            robot.detach(cup)

        par(hand_over, lambda: perform(type="moving", target=[-2, 0, 0]))


def the_torso_is_wanted_high_and_low() -> None:
    with BulletWorld() as world:
        robot = Object("pr2", "robot", "pr2.urdf", world=world)

        def look_down() -> None:
            robot.set_joint_position("torso_lift_joint", 0.3)
            assert robot.get_joint_position("torso_lift_joint") == 0.3

        def reach_low() -> None:
            robot.set_joint_position("torso_lift_joint", 0.0)
            robot.set_joint_position("head_tilt_joint", 0.5)

        par(look_down, reach_low)


# --- cancellation and cleaning up -------------------------------------------------------------------------------------


def a_cleanup_undoes_the_winner_s_work() -> None:
    with BulletWorld() as world:
        cup, bowl = cups(world, 2)

        def win() -> None:
            put(cup, 3)

        def lose() -> None:
            with finally_(lambda: put(cup, 0)):
                bowl.set_color(RED)
                bowl.set_color(GREEN)

        pursue(win, lose)


def half_a_place_setting_stays() -> None:
    with BulletWorld() as world:
        cup, saucer, bell = cups(world, 3)

        def lay() -> None:
            put(saucer, 3)
            put(cup, 3)

        try_all(lambda: bell.set_color(RED), lay)
        assert saucer.get_position()[0] == 1 or cup.get_position()[0] == 3


def others_take_the_time_of_a_timeout() -> None:
    with BulletWorld() as world:
        (cup,) = cups(world, 1)

        def hurry() -> None:
            with timeout(0.15, simulated=True):
                world.simulate(0.1)
                cup.set_color(RED)

        par(hurry, lambda: world.simulate(0.1))


def a_retreat_is_announced_too_late() -> None:
    with BulletWorld() as world:
        blocked = Fluent(False, "blocked")
        cup, bowl = cups(world, 2)

        def watch() -> None:
            with finally_(lambda: blocked.set_value(False)):
                cup.set_color(RED)
                blocked.set_value(True)
                cup.set_color(GREEN)

        def pass_by() -> None:
            bowl.set_color(RED)
            if blocked.get_value():
                raise PlanFailure("something is in the way")

        par(watch, pass_by)


# --- looked at, then done ---------------------------------------------------------------------------------------------


def two_things_at_one_place() -> None:
    with BulletWorld() as world:
        things = cups(world, 2)

        def is_free(x: float) -> bool:
            return all(abs(thing.get_position()[0] - x) > 0.1 for thing in things)

        def place(thing: Object) -> None:
            x = next(x for x in (5, 6, 7) if is_free(x))
            put(thing, x)

        par(lambda: place(things[0]), lambda: place(things[1]))
        assert things[0].get_position()[0] != things[1].get_position()[0]


def a_cup_is_removed_twice() -> None:
    with BulletWorld() as world:
        cup, other = cups(world, 2)

        def clear() -> None:
            if cup in world.objects:
                other.set_color(RED)
                cup.remove()

        par(clear, clear)


def a_drawer_is_closed_behind_the_check() -> None:
    with BulletWorld() as world:
        cabinet = Object("cabinet", "environment", CABINET, world=world)
        (cup,) = cups(world, 1)
        cabinet.set_joint_position("drawer_joint", 0.2)

        def put_in() -> None:
            if cabinet.get_joint_position("drawer_joint") > 0.1:
                put(cup, 9)
                assert cabinet.get_joint_position("drawer_joint") > 0.1

        def close() -> None:
            cabinet.set_joint_position("drawer_joint", 0.0)

        par(put_in, close)


def a_tray_is_fetched_twice() -> None:
    with BulletWorld() as world:
        (cup,) = cups(world, 1)
        trays: list[Object] = []

        def tray() -> None:
            if not trays:
                trays.append(Object(f"tray {len(trays)}", "bowl", "bowl.stl", world=world))

        def carry() -> None:
            if not trays:
                cup.set_color(RED)
                tray()
                put(trays[0], 2 + trays[0].get_position()[0])

        par(carry, carry)


def a_cup_is_carried_off_while_it_is_painted() -> None:
    with BulletWorld() as world:
        hand, cup = cups(world, 2)

        def paint() -> None:
            where = cup.get_position()
            cup.set_color(RED)
            put(cup, where[0], where[1])

        def carry_off() -> None:
            hand.attach(cup)
            put(hand, 8)

        par(paint, carry_off)
        assert cup.get_position()[1] == 5


# --- deadlocks --------------------------------------------------------------------------------------------------------


class Claim:
    """Something that one branch can have at a time."""

    def __init__(self, name: str) -> None:
        self.free = Fluent(True, name)

    def take(self) -> None:
        while not self.free.get_value():
            (self.free == True).wait_for()  # noqa: E712  a network
        self.free.set_value(False)

    def give(self) -> None:
        self.free.set_value(True)


def eat(first: Claim, second: Claim, cup: Object) -> None:
    first.take()
    cup.set_color(RED)
    second.take()
    second.give()
    first.give()


def knife_and_fork() -> None:
    with BulletWorld() as world:
        knife, fork = Claim("knife"), Claim("fork")
        one, two = cups(world, 2)
        par(lambda: eat(knife, fork, one), lambda: eat(fork, knife, two))


def three_philosophers() -> None:
    with BulletWorld() as world:
        forks = [Claim(f"fork {number}") for number in range(3)]
        with par as s:
            for number, cup in enumerate(cups(world, 3)):
                s(eat, forks[number], forks[(number + 1) % 3], cup)


def a_wake_up_comes_between_look_and_wait() -> None:
    with BulletWorld() as world:
        ready = Fluent(False, "ready")
        cup, bowl = cups(world, 2)

        def wait() -> None:
            if not ready.get_value():
                cup.set_color(RED)
                ready.pulsed().wait_for()

        def wake() -> None:
            bowl.set_color(RED)
            ready.set_value(True)

        par(wait, wake)


# --- rare ones --------------------------------------------------------------------------------------------------------


def a_value_comes_back() -> None:
    """Fails if another branch changes a value and changes it back, and only then."""
    with BulletWorld() as world:
        owner, changes = Fluent("nobody", "owner"), Fluent(0, "changes")
        (cup,) = cups(world, 1)

        def claim() -> None:
            before, known = owner.get_value(), changes.get_value()
            cup.set_color(RED)
            if owner.get_value() == before:
                assert changes.get_value() == known

        def borrow() -> None:
            for name in ("robot", "nobody"):
                cup.set_color(GREEN)
                owner.set_value(name)
                changes.set_value(changes.get_value() + 1)

        par(claim, borrow)


def a_short_window_in_a_long_plan() -> None:
    with BulletWorld() as world:
        count = Fluent(0, "count")

        def work(cup: Object) -> None:
            for number in range(12):
                cup.set_color(RED)
                if number == 6:
                    before = count.get_value()
                    cup.set_color(GREEN)
                    count.set_value(before + 1)

        with par as s:
            for cup in cups(world, 3):
                s(work, cup)
        assert count.get_value() == 3


def a_step_comes_between_two_steps_of_a_sequence() -> None:
    with BulletWorld() as world:
        lid = Fluent("on", "lid")
        cup, pot = cups(world, 2)

        def lift() -> None:
            checkpoint()
            lid.set_value("off")

        def lower() -> None:
            checkpoint()
            lid.set_value("on")

        def pour() -> None:
            pot.set_color(RED)
            if lid.get_value() == "off":
                raise PlanFailure("it spills")

        with par:
            with seq as t:
                t(lift)
                t(cup.set_color, RED)
                t(lower)
            with seq as t:
                t(pot.set_color, GREEN)
                t(pour)


RACES: Final[tuple[Callable[[], None], ...]] = (
    a_count_loses_one,
    stock_is_taken_twice,
    a_list_forgets_what_was_seen,
    the_highest_isn_t_kept,
    a_battery_forgets_that_it_was_charged,
    an_event_comes_before_its_handler,
    a_pulse_comes_before_the_wait,
    a_door_is_open_for_a_moment,
    one_of_three_orders_is_served,
    a_signal_is_looked_at_once,
    a_gripper_is_opened_and_closed,
    two_branches_drive,
    two_arms_want_one_cup,
    the_base_leaves_before_the_arm_is_done,
    the_torso_is_wanted_high_and_low,
    a_cleanup_undoes_the_winner_s_work,
    half_a_place_setting_stays,
    others_take_the_time_of_a_timeout,
    a_retreat_is_announced_too_late,
    two_things_at_one_place,
    a_cup_is_removed_twice,
    a_drawer_is_closed_behind_the_check,
    a_tray_is_fetched_twice,
    a_cup_is_carried_off_while_it_is_painted,
    knife_and_fork,
    three_philosophers,
    a_wake_up_comes_between_look_and_wait,
    a_value_comes_back,
    a_short_window_in_a_long_plan,
    a_step_comes_between_two_steps_of_a_sequence,
)
