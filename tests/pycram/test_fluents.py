"""Fluents: what their table of semantics says, laws of networks, threads, leaks, and the world that they follow.

No test waits for time to pass: a network's function tells when somebody who waits has looked at a value.
"""

from __future__ import annotations

import gc
import itertools
import json
import math
import operator
import signal
import threading
from contextlib import contextmanager
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.cancellation import Cancelled, Scope, entered
from pycram.failures import BadArgument, UnknownName, Unreachable, WorldClosed
from pycram.fluent import Behavior, Fluent, NotSettable, NotTrueOrFalse, network, whenever
from pycram.fluents.terms import Term
from pycram.fluents.watch import Watch
from pycram.fluents.world import contact, holding, joint, pose, position
from pycram.language import par
from recorder import journal
from recorder.records import Fluent as FluentRecord
from recorder.records import Mutation, Task
from replay import cli

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.conftest import MemorySink

PATIENCE = 20  # s after which a test that hangs fails


class Running:
    """A function in a thread of its own, within a scope."""

    def __init__(self, action: Callable[[], object]) -> None:
        self.scope = Scope()
        self.outcome: object = None
        self.thread = threading.Thread(target=self._run, args=(action,), daemon=True)
        self.thread.start()

    def _run(self, action: Callable[[], object]) -> None:
        with entered(self.scope):
            try:
                self.outcome = action()
            except BaseException as error:  # noqa: BLE001  the test looks at it
                self.outcome = error

    def end(self) -> object:
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive(), "it still waits"
        return self.outcome


@contextmanager
def waiting(fluent: Fluent, timeout: float | None = None) -> Iterator[Running]:
    """Somebody who waits for a fluent, and has looked at its value when the block begins."""
    looked = threading.Event()

    def look(value: object) -> object:
        looked.set()
        return value

    running = Running(lambda: network(look, fluent).wait_for(timeout))
    assert looked.wait(PATIENCE)
    yield running
    running.end()


# --- the table ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("network_of", "left", "right", "value"),
    [
        (lambda a, b: a == b, 2, 2, True),
        (lambda a, b: a == b, 2, 3, None),
        (lambda a, b: a != b, 2, 3, True),
        (lambda a, b: a != b, 2, 2, None),
        (lambda a, b: a < b, 2, 3, True),
        (lambda a, b: a < b, 3, 3, None),
        (lambda a, b: a <= b, 3, 3, True),
        (lambda a, b: a <= b, 4, 3, None),
        (lambda a, b: a > b, 3, 2, True),
        (lambda a, b: a > b, 3, 3, None),
        (lambda a, b: a >= b, 3, 3, True),
        (lambda a, b: a >= b, 2, 3, None),
        (lambda a, b: a + b, 2, 3, 5),
        (lambda a, b: a - b, 2, 3, -1),
        (lambda a, b: a * b, 2, 3, 6),
        (lambda a, b: a / b, 3, 2, 1.5),
        (lambda a, b: a + b, "mi", "lk", "milk"),
        (lambda a, b: a.AND(b), True, 1, True),
        (lambda a, b: a.AND(b), True, False, None),
        (lambda a, b: a.AND(b), None, True, None),
        (lambda a, b: a.OR(b), None, "x", True),
        (lambda a, b: a.OR(b), 0, False, None),
        (lambda a, b: a.IS(b), None, None, True),
        (lambda a, b: a.IS(b), [1], [1], None),
        (lambda a, b: a.IS_NOT(b), [1], [1], True),
        (lambda a, b: a.IS_NOT(b), True, True, None),
    ],
)
def test_operators_take_fluents_and_plain_values_on_both_sides(
    network_of: Callable[[object, object], Fluent], left: object, right: object, value: object
) -> None:
    of_two = network_of(Fluent(left), Fluent(right))
    assert (of_two.get_value(), network_of(Fluent(left), right).get_value()) == (value, value)
    assert type(of_two.get_value()) is type(value)
    if not network_of.__code__.co_names:  # an operator, not a method: the fluent may stand on the right
        assert network_of(left, Fluent(right)).get_value() == value


@pytest.mark.parametrize(("value", "negated"), [(None, True), (False, True), (0, True), ("", True), (1, None)])
def test_not_is_true_of_whatever_is_false(value: object, negated: object) -> None:
    assert Fluent(value).NOT().get_value() is negated


@pytest.mark.parametrize("value", [True, False, 0, "", (), "milk"])
def test_everything_but_none_is_worth_waiting_for(value: object) -> None:
    fluent = Fluent()
    assert not fluent.wait_for(timeout=0)
    with waiting(fluent) as running:
        fluent.set_value(value)
        assert running.end() is True
    assert fluent.wait_for()


def test_networks_follow_their_operands() -> None:
    a, b = Fluent(1), Fluent(2)
    total, larger = a + b, (a + b > 4).AND(b.IS_NOT(None))
    assert (total.get_value(), larger.get_value()) == (3, None)
    b.set_value(4)
    assert (total.get_value(), larger.get_value()) == (5, True)
    a.set_value(0.5)
    assert (total.get_value(), larger.get_value()) == (4.5, True)
    scaled = network(lambda x, factor, y: (x * factor, y), a, 10, b)
    assert scaled.get_value() == (5.0, 4)


def test_a_wait_ends_when_its_time_is_up() -> None:
    fluent = Fluent(1)
    assert (fluent > 3).wait_for(timeout=0.01) is False
    assert (fluent > 3).wait_for(0) is False
    assert (fluent < 3).wait_for(0) is True
    assert fluent.wait_for(1e300) is True
    with pytest.raises(BadArgument, match="timeout"):
        fluent.wait_for(math.nan)


def test_false_wakes_those_who_wait_for_a_not() -> None:
    fluent = Fluent(True)
    with waiting(fluent.NOT()) as running:
        fluent.set_value(False)
        assert running.end() is True


def test_all_who_wait_wake() -> None:
    fluent = Fluent()
    with waiting(fluent) as one, waiting(fluent > 3) as two, waiting(fluent) as three:
        fluent.set_value(4)
        assert [running.end() for running in (one, two, three)] == [True] * 3


def test_a_moment_is_long_enough_to_be_seen() -> None:
    fluent = Fluent(0)
    with waiting(fluent == 1) as running:
        fluent.set_value(1)
        fluent.set_value(0)
        assert running.end() is True


def test_a_guard_keeps_the_other_side_from_being_looked_at() -> None:
    speed = Fluent(0)
    soon, standing_or_late = (speed != 0).AND(100 / speed < 10), (speed == 0).OR(100 / speed >= 10)
    assert (soon.get_value(), standing_or_late.get_value()) == (None, True)
    speed.set_value(20)
    assert (soon.get_value(), standing_or_late.get_value()) == (True, None)
    speed.set_value(5)
    assert (soon.get_value(), standing_or_late.get_value()) == (None, True)


def test_what_has_no_value_yet_is_neither_less_nor_more_and_adds_up_to_nothing() -> None:
    reading = Fluent()
    for made in (reading < 20, reading >= 20, reading > Fluent(), reading + 1, 2 * reading, reading / reading - 1):
        assert made.get_value() is None
        with waiting(made) as running:
            assert running.outcome is None
            running.scope.cancel()
    assert (reading == None).get_value() is True  # noqa: E711  a network
    assert reading.IS(None).get_value() is True


def test_what_a_network_cant_work_out_is_told_to_who_asks_or_waits_not_to_who_sets() -> None:
    fluent = Fluent(1)
    inverse = 1 / fluent > 2
    with waiting(inverse) as running:
        fluent.set_value(0)
        assert isinstance(running.end(), ZeroDivisionError)
    with pytest.raises(ZeroDivisionError):
        inverse.get_value()
    fluent.set_value(0.1)
    assert inverse.get_value() is True


def test_handles_stand_for_their_results() -> None:
    with par as s:
        handle = s(lambda: 4)
        fluent = Fluent(handle)
        more = fluent + s(lambda: 3)
    assert fluent.get_value() == 4
    assert more.get_value() == 7
    assert type(fluent.get_value()) is int


# --- fluents as things --------------------------------------------------------------------------------------------------


def test_fluents_stand_in_sets_lists_and_dictionaries_though_equality_makes_a_network() -> None:
    a, b, c = Fluent(1), Fluent(1), Fluent(1)
    assert {a, b, a} == {b, a}
    assert {a: "a", b: "b"}[b] == "b"
    assert b in [a, b]
    assert c not in [a, b]
    assert c not in {a, b}
    assert [a, b, c].index(c) == 2
    assert (a == b).get_value() is True


@pytest.mark.parametrize(
    "condition", [lambda f: f, lambda f: f == 1, lambda f: f < 2, lambda f: f.NOT(), lambda f: 0 < f < 2]
)
def test_a_fluent_as_a_condition_is_an_error_that_says_what_to_do(condition: Callable[[Fluent], object]) -> None:
    with pytest.raises(NotTrueOrFalse, match=r"get_value\(\).*AND"):
        assert condition(Fluent(1))


def test_in_a_list_of_other_things_is_an_error_too() -> None:
    fluent = Fluent(1)
    things: list[object] = [3, fluent]
    with pytest.raises(NotTrueOrFalse):
        assert fluent in things
    assert any(one is fluent for one in things)


def test_the_rest_of_arithmetic() -> None:
    a, b, none = Fluent(7, "a"), Fluent(2, "b"), Fluent(None, "c")
    for made, value, name in (
        (a // b, 3, "a // b"),
        (15 // a, 2, "15 // a"),
        (a % 4, 3, "a % 4"),
        (9 % a, 2, "9 % a"),
        (a**b, 49, "a ** b"),
        (2**a, 128, "2 ** a"),
        (-a + b, -5, "(-a) + b"),
        (+a, 7, "+a"),
        (abs(b - a), 5, "abs((b - a))"),
    ):
        assert (made.get_value(), made.name) == (value, name)
    assert [made.get_value() for made in (none // 2, none % 2, none**2, -none, abs(none))] == [None] * 5


def test_networks_may_be_as_deep_as_they_like() -> None:
    one, asked = Fluent(1), []
    deep = never = one
    for _ in range(3000):
        deep = deep + one
        never = network(lambda *values: asked.append(values), never)
    assert deep.get_value() == 3001
    assert (one == 2).OR(deep > 0).get_value() is True
    assert (one == 1).OR(never).get_value() is True
    assert not asked  # the second operand is looked at only if the first one isn't true
    condition = deep > 6000
    with waiting(condition) as running:
        one.set_value(2)
    assert running.end() is True
    for _ in range(1500):
        condition = (one == 2).AND(condition)
    assert condition.get_value() is True
    del deep, condition, never  # all at once, and however deep
    assert one.get_value() == 2


def test_arrays_leave_operators_to_fluents() -> None:
    shift = np.array([1.0, 2.0])
    moved = shift + Fluent(np.array([1.0, 1.0]))
    assert isinstance(moved, Fluent)
    assert moved.get_value().tolist() == [2.0, 3.0]


def test_only_variables_are_set() -> None:
    fluent = Fluent(1)
    for derived in (fluent + 1, fluent.pulsed()):
        with pytest.raises(NotSettable, match="other fluents"):
            derived.set_value(2)
    for function in (lambda: 1, test_only_variables_are_set):
        with pytest.raises(BadArgument, match="network"):
            Fluent(function)
    assert Fluent(Unreachable).get_value() is Unreachable
    with pytest.raises(BadArgument, match="Behavior"):
        fluent.pulsed(2)
    with pytest.raises(BadArgument):
        whenever(1)
    with pytest.raises(BadArgument):
        whenever(fluent, 1)
    with pytest.raises(BadArgument):
        network(1, fluent)


def test_names_tell_what_networks_are() -> None:
    a, b = Fluent(1, "a"), Fluent(2, "b")
    assert repr((a + 1 > b).AND(a.NOT())) == "Fluent(((a + 1) > b) AND (NOT a))"
    assert (network(math.hypot, a, b) > 3).name == "hypot(a, b) > 3"
    assert a.pulsed().name == "a.pulsed(ONCE)"
    assert (a == {"{}": 1}).name == "a == {'{}': 1}"
    deep = a
    for _ in range(300):
        deep = deep + deep
    assert len(deep.name) < 500
    assert deep.get_value() == 2**300


# --- pulses ------------------------------------------------------------------------------------------------------------


def runs(pulsed: Fluent, during_the_first: Callable[[], object]) -> int:
    """How often the body of a ``whenever`` runs until it has nothing to do."""
    idle, begun, go_on = threading.Event(), threading.Event(), threading.Event()
    count = 0

    def look(value: object) -> object:
        if value is None and begun.is_set():
            idle.set()
        return value

    def body() -> None:
        nonlocal count
        count += 1
        begun.set()
        assert go_on.wait(PATIENCE)

    running = Running(lambda: whenever(network(look, pulsed), body))
    assert begun.wait(PATIENCE)
    during_the_first()
    go_on.set()
    assert idle.wait(PATIENCE)
    running.scope.cancel()
    assert isinstance(running.end(), Cancelled)
    return count


@pytest.mark.parametrize(("behavior", "expected"), [(Behavior.NEVER, 1), (Behavior.ONCE, 2), (Behavior.ALWAYS, 5)])
@pytest.mark.parametrize("late", [0, 4], ids=["before", "while busy"])
def test_five_pulses_while_the_body_is_busy(behavior: Behavior, expected: int, late: int) -> None:
    fluent = Fluent()
    pulsed = fluent.pulsed(behavior)

    def pulse(times: int) -> None:
        for number in range(times):
            fluent.pulse() if number % 2 else fluent.set_value("the same")

    pulse(5 - late)
    assert runs(pulsed, lambda: pulse(late)) == expected
    assert pulsed.get_value() is None
    fluent.pulse()
    assert pulsed.get_value() is True


def test_once_is_the_default() -> None:
    fluent = Fluent()
    pulsed = fluent.pulsed()
    for _ in range(5):
        fluent.pulse()
    assert runs(pulsed, lambda: None) == 2


def test_a_pulse_reaches_what_is_made_of_its_fluent_once_and_nothing_else() -> None:
    a, b = Fluent(1), Fluent(2)
    both = (a + b) * a
    of_both, of_a, of_b, of_of = both.pulsed(Behavior.ALWAYS), a.pulsed(), b.pulsed(), both.pulsed().pulsed()
    of_pulses = of_both.AND(of_a).pulsed(Behavior.ALWAYS)
    a.pulse()
    assert [fluent.get_value() for fluent in (of_both, of_a, of_b, of_of)] == [True, True, None, True]
    for pulsed in (of_both, of_pulses):
        next(whenever(pulsed))
        assert pulsed.get_value() is None  # one, though two ways lead from a to it
    both.pulse()
    assert [fluent.get_value() for fluent in (of_both, of_b)] == [True, None]


def test_a_loop_handles_each_pulse_until_it_breaks() -> None:
    door = Fluent("shut", "door")
    told = []
    pulsed = door.pulsed(Behavior.ALWAYS)
    for state in ("open", "shut", "open"):
        door.set_value(state)
    for _ in whenever(pulsed):
        told.append(door.get_value())
        if len(told) == 2:
            break
    assert len(told) == 2
    assert pulsed.get_value() is True  # the third


def test_whenever_of_a_condition_runs_as_long_as_it_holds() -> None:
    level = Fluent(3)
    poured = 0
    for value in whenever(network(lambda x: x or None, level)):
        assert value == level.get_value()
        poured += 1
        level.set_value(level.get_value() - 1)
        if level.get_value() == 0:
            break
    assert poured == 3


def test_what_the_body_raises_ends_whenever() -> None:
    fluent = Fluent(1)

    def body() -> None:
        raise Unreachable("left", [1, 2, 3])

    with pytest.raises(Unreachable):
        whenever(fluent, body)


# --- laws --------------------------------------------------------------------------------------------------------------

OPERATORS = {
    "==": (operator.eq, True), "!=": (operator.ne, True), "<": (operator.lt, True), "<=": (operator.le, True),
    ">": (operator.gt, True), ">=": (operator.ge, True), "+": (operator.add, False), "-": (operator.sub, False),
    "*": (operator.mul, False), "AND": (lambda a, b: a and b, True), "OR": (lambda a, b: a or b, True),
}  # fmt: skip
numbers = st.integers(-3, 3)
trees = st.recursive(
    st.sampled_from("abc") | numbers,
    lambda inner: st.tuples(st.sampled_from(sorted(OPERATORS)), inner, inner),
    max_leaves=12,
)


def built(tree: object, fluents: dict[str, Fluent]) -> object:
    if not isinstance(tree, tuple):
        return fluents.get(tree, tree)
    name, left, right = tree[0], built(tree[1], fluents), built(tree[2], fluents)
    if name in ("AND", "OR"):
        return getattr(left if isinstance(left, Fluent) else Fluent(left), name)(right)
    if not isinstance(left, Fluent) and not isinstance(right, Fluent):
        left = Fluent(left)
    return OPERATORS[name][0](left, right)


def expected(tree: object, values: dict[str, int]) -> object:
    if not isinstance(tree, tuple):
        return values.get(tree, tree)
    function, is_condition = OPERATORS[tree[0]]
    operands = [expected(operand, values) for operand in tree[1:]]
    if None in operands and tree[0] not in ("==", "!=", "AND", "OR"):
        return None
    made = function(*operands)
    return (True if made else None) if is_condition else made


@given(trees, st.lists(st.tuples(st.sampled_from("abc"), numbers), max_size=5))
def test_a_networks_value_is_the_function_of_its_operands_values(tree: object, sets: list[tuple[str, int]]) -> None:
    values = {"a": 0, "b": 1, "c": 2}
    fluents = {name: Fluent(value, name) for name, value in values.items()}
    made = built(tree, fluents)
    for name, value in [("a", 0), *sets]:
        values[name] = value
        fluents[name].set_value(value)
        assert (made.get_value() if isinstance(made, Fluent) else made) == expected(tree, values)


# --- threads -----------------------------------------------------------------------------------------------------------


def test_a_network_never_shows_a_mix_of_two_moments() -> None:
    a = Fluent(0)
    mixed = network(lambda one, two: None if two - one == 1 else (one, two), a, a + 1)
    with waiting(mixed.OR(a == -1)) as running:
        setting = Running(lambda: [a.set_value(number) for number in range(2000)])
        while setting.thread.is_alive():
            assert mixed.get_value() is None
        setting.end()
        assert running.outcome is None  # the one who waits saw all 2000 and no mix
        a.set_value(-1)
        assert running.end() is True
    assert mixed.get_value() is None


def test_functions_of_networks_may_wait_for_other_threads_and_run_where_one_asks() -> None:
    a = Fluent(1)
    where: list[str] = []

    def function(value: int) -> int | None:
        where.append(threading.current_thread().name)
        other = Running(lambda: a.pulsed().get_value())  # needs the lock of all fluents
        assert other.end() is None
        return value if value > 1 else None

    with waiting(network(function, a)) as running:
        a.set_value(2)
        assert running.end() is True
    assert threading.current_thread().name not in where


def test_many_threads_set_and_wait() -> None:
    turn = Fluent(0)
    count = 8

    def play(number: int) -> int:
        for round_ in range(10):
            assert (turn == round_ * count + number).wait_for(PATIENCE)
            turn.set_value(turn.get_value() + 1)
        return number

    players = [Running(lambda number=number: play(number)) for number in range(count)]
    assert [player.end() for player in players] == list(range(count))
    assert turn.get_value() == 10 * count


@pytest.mark.parametrize("kind", ["value", "network", "pulsed", "whenever"])
def test_a_cancelled_branch_leaves_its_wait_at_once(kind: str) -> None:
    fluent = Fluent()
    if kind == "whenever":
        looked = threading.Event()
        watched = network(lambda value: (looked.set(), value)[1], fluent)
        running = Running(lambda: [None for _ in whenever(watched)])
        assert looked.wait(PATIENCE)
        running.scope.cancel()
    else:
        awaited = {"value": fluent, "network": fluent.IS(3), "pulsed": fluent.pulsed()}[kind]
        with waiting(awaited) as running:
            running.scope.cancel()
    assert isinstance(running.end(), Cancelled)
    assert not fluent.term.watchers
    fluent.set_value(3)


def test_a_wait_ends_in_time_or_when_cancelled_however_often_the_value_changes() -> None:
    fluent = Fluent(0)
    looked = threading.Event()

    def another(value: int) -> None:
        fluent.set_value(value + 1)
        if value > 100:
            looked.set()

    restless = network(another, fluent)
    assert restless.wait_for(timeout=0.01) is False
    running = Running(restless.wait_for)
    assert looked.wait(PATIENCE)
    running.scope.cancel()
    assert isinstance(running.end(), Cancelled)


def test_a_cancelled_branch_doesnt_go_on_though_the_value_is_there() -> None:
    fluent = Fluent(1)
    scope = Scope()
    scope.cancel()
    with entered(scope):
        with pytest.raises(Cancelled):
            fluent.wait_for()
        with pytest.raises(Cancelled):
            next(whenever(fluent))


def test_a_block_that_is_broken_off_takes_what_waits_in_it_along() -> None:
    battery, charged = Fluent(100, "battery"), Fluent(0)
    threads = threading.active_count()

    def charge() -> None:
        battery.set_value(100)
        charged.set_value(charged.get_value() + 1)

    def plan() -> None:
        with par as s:
            s(whenever, battery < 20, charge)
            s((battery < 0).wait_for)
            for times in range(1, 4):
                battery.set_value(10)
                assert (charged == times).wait_for(PATIENCE)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan()
    assert threading.active_count() == threads
    assert not battery.term.watchers


def test_an_old_values_finalizer_may_use_fluents() -> None:
    fluent, told = Fluent(), Fluent(0)

    class Old:
        def __del__(self) -> None:
            assert Running(lambda: told.set_value(told.get_value() + 1)).end() is None  # in another thread

    fluent.set_value(Old())
    fluent.set_value(None)
    assert told.get_value() == 1


def test_ctrl_c_ends_a_wait() -> None:
    fluent = Fluent()
    main = threading.get_ident()
    looked = threading.Event()
    watched = network(lambda value: (looked.set(), value)[1], fluent)
    over = threading.Event()

    def press() -> None:
        assert looked.wait(PATIENCE)
        signal.pthread_kill(main, signal.SIGINT)
        if not over.wait(1):  # CPython sees one only later that comes just before it goes to sleep
            signal.pthread_kill(main, signal.SIGINT)

    running = Running(press)
    with pytest.raises(KeyboardInterrupt):
        watched.wait_for(PATIENCE)
    over.set()
    running.end()
    assert not fluent.term.watchers


# --- leaks -------------------------------------------------------------------------------------------------------------


def test_dropped_networks_leave_nothing_behind() -> None:
    def alive() -> int:
        return sum(isinstance(one, Fluent | Term | Watch) for one in gc.get_objects())

    fluent = Fluent(1)
    gc.collect()  # what tests before this one left
    before = alive()
    for number in range(500):
        of_it = (fluent > number).AND(fluent + 1).pulsed()
        assert not of_it.wait_for(0)
        fluent.pulse()
    del of_it
    assert alive() == before, "gone at once, without the garbage collector"
    assert not fluent.term.watchers
    assert not fluent.term.accounts


def test_a_network_keeps_its_operands_alive() -> None:
    total = Fluent(1) + Fluent(2)
    pulsed = (Fluent(1) + 1).pulsed()
    gc.collect()
    assert total.get_value() == 3
    assert pulsed.get_value() is None


# --- the world ---------------------------------------------------------------------------------------------------------


def test_fluents_are_what_the_world_says_whatever_changes_it(scene: BulletWorld) -> None:
    robot, milk, kitchen = scene.robot, scene.get_object("milk"), scene.get_object("kitchen")
    tool = "l_gripper_tool_frame"
    fluents = [pose(milk), position(robot), pose(robot, tool), joint(robot, "torso_lift_joint"), joint(kitchen, "iai_fridge_door_joint"),
               holding(robot), holding(robot, "left"), holding(robot, "right"), contact(milk, kitchen)]  # fmt: skip

    def said() -> list[object]:
        def at(body: Object, link: str | None = None) -> tuple[object, object]:
            place, turn = (
                body.get_position_and_orientation() if link is None else body.get_link_position_and_orientation(link)
            )
            return tuple(place), tuple(turn)

        held = milk.name if milk.carrier is robot else None
        left = held if held and robot.attachments[milk].carrier_link == tool else None
        near = kitchen.world.engine.touches(milk.handle, kitchen.handle, 1e-3)
        return [at(milk), at(robot)[0], at(robot, tool), robot.get_joint_position("torso_lift_joint"),
                kitchen.get_joint_position("iai_fridge_door_joint"), held, left, None, True if near else None]  # fmt: skip

    def check() -> list[object]:
        values = [fluent.get_value() for fluent in fluents]
        assert values == said()
        return values

    seen = [check()]
    for change in (
        lambda: milk.set_position([1.3, 1, 1.4]),
        lambda: scene.simulate(0.5),
        lambda: robot.attach(milk, tool),
        lambda: robot.set_joint_position("torso_lift_joint", 0.3),
        lambda: robot.set_position([0.4, 0.7, 0]),
        lambda: kitchen.set_joint_position("iai_fridge_door_joint", 0.7),
        lambda: robot.detach(milk),
        lambda: robot.attach(milk),
        scene.reset,
    ):
        change()
        seen.append(check())
    for values in zip(*[one[:7] + one[8:] for one in seen], strict=True):
        assert len(set(values)) > 1, "each of them has changed"


def test_what_moves_together_is_never_seen_apart(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    robot.attach(milk, "l_gripper_tool_frame")
    apart = math.dist(robot.get_position(), milk.get_position())
    torn = network(
        lambda a, b: None if math.isclose(math.dist(a, b), apart, abs_tol=1e-6) else (a, b),
        position(robot),
        position(milk),
    )
    arrived = network(lambda at: True if at[0] > 5 else None, position(robot))
    seen: list[object] = []
    with waiting(network(lambda bad, end: seen.append(bad) or end, torn, arrived)) as running:
        for step in range(7):
            robot.set_position([step, 0, 0])
        assert running.end() is True
    assert len(seen) > 6
    assert set(seen) == {None}


def test_a_plan_reacts_to_what_happens_while_time_is_simulated(scene: BulletWorld, sink: MemorySink) -> None:
    milk, kitchen = scene.get_object("milk"), scene.get_object("kitchen")
    milk.set_position([1.3, 1, 1.2])
    falling = network(itemgetter(2), position(milk))
    landed = contact(milk, kitchen)
    assert landed.get_value() is None
    begin = scene.sim_step
    with waiting((falling < 1.15).AND(falling > 1.05)) as passing, waiting(landed) as landing:
        scene.simulate(1)
        assert (passing.end(), landing.end()) == (True, True)
    told = [record for record in sink.of(FluentRecord) if record.source == "contact"]
    assert json.loads(told[0].before_json) is None
    assert json.loads(told[0].after_json) is True
    assert begin < told[0].sim_step < scene.sim_step
    falls = [record for record in sink.of(FluentRecord) if record.source == "position"]
    assert [record.sim_step for record in falls] == sorted(record.sim_step for record in falls)
    assert json.loads(falls[-1].after_json) == milk.get_position()


def test_handlers_and_those_who_wait_find_the_world_free(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    picked = holding(robot, "left") == "milk"
    told: list[object] = []
    event = scene.get_attachment_event()
    event += lambda *_: told.append(Running(lambda: picked.wait_for(PATIENCE) and milk.get_position()).end())

    def carry_on() -> list[float]:
        assert picked.wait_for()
        milk.set_color([1, 0, 0, 1])
        return milk.get_position()

    running = Running(carry_on)
    robot.attach(milk, "l_gripper_tool_frame")
    assert told == [milk.get_position()]
    assert running.end() == milk.get_position()


def test_what_is_gone_says_so_to_all_who_ask_or_wait(scene: BulletWorld) -> None:
    robot, milk, bowl = scene.robot, scene.get_object("milk"), scene.get_object("bowl")
    robot.attach(milk, "l_gripper_tool_frame")
    held, place = holding(robot, "left"), position(bowl)
    with waiting(contact(milk, bowl)) as touching, waiting(position(milk).pulsed()) as moving:
        milk.remove()
        for running in (touching, moving):
            assert isinstance(running.end(), WorldClosed)
            assert "object milk" in str(running.outcome)
    assert held.get_value() is None
    assert place.get_value() == tuple(bowl.get_position())
    Object("milk", "milk", "milk.stl", [0, 0, 3])
    assert position(scene.get_object("milk")).get_value() == (0, 0, 3)
    with waiting(held) as running:
        scene.exit()
        assert isinstance(running.end(), WorldClosed)
    with pytest.raises(WorldClosed, match="the world is gone"):
        place.get_value()
    with pytest.raises(WorldClosed):
        position(bowl)


def test_worlds_that_nobody_follows_do_nothing_for_fluents(scene: BulletWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    milk, kitchen = scene.get_object("milk"), scene.get_object("kitchen")
    assert scene.funnel.observer is None
    followed = contact(milk, kitchen)
    asked = []
    monkeypatch.setattr("pycram.fluents.world.touches", lambda *_: asked.append(1))
    scene.robot.set_position([0.5, 0.5, 0])
    assert not asked  # it doesn't concern them
    milk.set_position([1.3, 1, 1.2])
    assert len(asked) == 1
    del followed
    milk.set_position([1.3, 1, 1.3])
    scene.simulate(0.1)
    assert len(asked) == 1


def test_bad_names_are_told_at_once(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    with pytest.raises(UnknownName, match="torso_lift_joint"):
        joint(robot, "torso_lift_jont")
    with pytest.raises(UnknownName):
        pose(robot, "left_hand")
    with pytest.raises(UnknownName):
        holding(robot, "middle")
    with pytest.raises(BadArgument, match="arms"):
        holding(milk, "left")
    with pytest.raises(BadArgument):
        position("milk")
    with pytest.raises(NotSettable, match="world"):
        position(milk).set_value((0, 0, 0))
    with BulletWorld() as other:
        stranger = Object("cup", "cup", "cup.stl", world=other)
        with pytest.raises(BadArgument, match="object of"):
            contact(milk, stranger)


# --- records -----------------------------------------------------------------------------------------------------------


def test_every_change_is_on_record_and_comes_back_from_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "fluents.mcap"
    battery = Fluent(100, "battery")
    with recorder.record(file), BulletWorld() as world:
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        place = position(cup)
        with par as s:
            s((battery < 20).wait_for, PATIENCE)
            battery.set_value(50)
            battery.set_value(10)
        battery.pulse()
        cup.set_position([1, 0, 1])
        assert place.get_value() == (1, 0, 1)
        name = world.name
    with replay.open(file) as log:
        told = [record for record in log.records(FluentRecord) if isinstance(record, FluentRecord)]
        assert [(one.name, json.loads(one.before_json), json.loads(one.after_json)) for one in told] == [
            ("battery", 100, 50),
            ("battery", 50, 10),
            ("battery", 10, 10),
            ("position of cup", [0, 0, 1], [1, 0, 1]),
        ]
        assert [(one.source, list(one.bodies), one.world) for one in told[2:]] == [
            ("", [], ""),
            ("position", ["cup"], name),
        ]
        cause = log[told[3].seq - 1]
        assert isinstance(cause, Mutation)
        assert cause.WhichOneof("command") == "move_body"
        waits = [one for one in log.records(Task) if isinstance(one, Task) and one.kind == "wait"]
        assert [one.name for one in waits] == ["battery < 20"] * 2
        assert [(told.name, json.loads(told.json)) for told in waits[0].parameters][1:] == [("timeout", PATIENCE)]
        assert waits[0].parameters[0].name == "battery"
        assert json.loads(waits[1].result_json) is True
        assert log.counts()["fluent"] == 4
        step = told[3].seq
    assert cli.main(["log", str(file), "--kind", "fluent"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].endswith("fluent battery: 100 -> 50")
    assert lines[2].endswith("fluent battery pulsed at 10")
    assert cli.main(["log", str(file), "--kind", "fluent", "--object", "cup"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    assert cli.main(["show", str(file), str(step), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["kind"], shown["before"], shown["after"]) == ("fluent", [0, 0, 1], [1, 0, 1])


def test_changes_of_many_threads_stand_in_the_log_in_their_order(sink: MemorySink) -> None:
    fluent = Fluent(0, "shared")
    setting = [Running(lambda k=k: [fluent.set_value(k * 1000 + i) for i in range(50)]) for k in range(4)]
    for one in setting:
        one.end()
    told = sink.of(FluentRecord)
    assert len(told) == 200
    assert told[0].before_json == "0"
    assert all(one.after_json == following.before_json for one, following in itertools.pairwise(told))
    assert json.loads(told[-1].after_json) == fluent.get_value()


def test_a_change_that_cant_be_recorded_isnt_made() -> None:
    class Full:
        def write(self, *_: object) -> None:
            raise OSError("the disk is full")

        def attach(self, *_: object) -> None: ...

        def close(self) -> None: ...

    fluent = Fluent(1)
    pulsed = fluent.pulsed()
    log = journal.Journal([Full()])
    journal.open_journal(log)
    try:
        with pytest.raises(OSError, match="full"):
            fluent.set_value(2)
        with pytest.raises(OSError, match="full"):
            fluent.pulse()
    finally:
        journal.close_journal(log)
    assert fluent.get_value() == 1
    assert pulsed.get_value() is None


def test_values_are_not_told_while_nothing_is_recorded(request: pytest.FixtureRequest) -> None:
    told = []

    class Value:
        def __record__(self) -> str:
            told.append(self)
            return "told"

    fluent = Fluent(Value())
    fluent.set_value(Value())
    fluent.pulse()
    assert not told
    sink: MemorySink = request.getfixturevalue("sink")
    fluent.set_value(1)
    assert [(one.before_json, one.after_json) for one in sink.of(FluentRecord)] == [('"told"', "1")]


def test_values_stand_in_records_as_they_were_when_set(sink: MemorySink) -> None:
    value = [1]
    fluent = Fluent(value, "list")
    fluent.set_value(value)
    value.append(2)
    fluent.set_value(None)
    told = [(one.before_json, one.after_json) for one in sink.of(FluentRecord)]
    assert told == [("[1]", "[1]"), ("[1]", "null")]
