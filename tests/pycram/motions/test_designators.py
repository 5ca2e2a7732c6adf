"""Designators: slots, solutions, and users' own resolvers."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest

from pycram import action_designators as actions, motion_designators as motions
from pycram.actions.action import TYPES as ACTIONS
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import DesignatorError, MotionDesignator
from pycram.failures import BadArgument
from pycram.process_module import ProcessModule, register

if TYPE_CHECKING:
    from collections.abc import Iterator


def looking(**more: object) -> MotionDesignator:
    return MotionDesignator([("type", "looking"), ("target", [1, 0, 1]), *more.items()])


def test_slots_are_read_checked_and_copied() -> None:
    designator = MotionDesignator([("type", "moving"), ("target", [1, 2, 0])])
    assert designator.prop_value("target") == [1, 2, 0]
    assert designator.prop_value("nothing") is None
    assert designator.check_constraints([("type", "moving"), "target"])
    assert not designator.check_constraints([("type", "moving"), "orientation"])
    assert not designator.check_constraints([("type", "looking")])
    made = designator.make_dictionary([("cmd", "navigate"), "target", ("orientation", [0, 0, 0, 1])])
    assert made == {"cmd": "navigate", "target": [1, 2, 0], "orientation": [0, 0, 0, 1]}
    copy = designator.copy([("target", [0, 0, 0])])
    assert copy.prop_value("target") == [0, 0, 0]
    assert designator.prop_value("target") == [1, 2, 0]


def test_equated_designators_share_the_newest_effective_one() -> None:
    first, second = looking(), looking()
    assert not first.equal(second)
    second.equate(first)
    assert second.first() is first
    assert first.current() is second
    assert first.newest_effective() is None
    first.reference()
    assert second.newest_effective() is first
    found = second.make_effective(data="the thing", timestamp=12.0)
    assert found.reference() == "the thing"
    assert first.current() is first.newest_effective() is found
    assert found.timestamp == 12.0


def test_solutions_are_resolved_lazily() -> None:
    asked: list[int] = []

    def resolver(designator: MotionDesignator) -> object:
        if designator.type != "waving":
            return
        for number in range(3):
            asked.append(number)
            yield {"cmd": "wave", "times": number}

    with MotionDesignator.resolvers.added(resolver):
        designator = MotionDesignator([("type", "waving")])
        assert designator.reference() == designator.reference() == {"cmd": "wave", "times": 0}
        assert asked == [0]
        following = designator.next_solution()
        assert following.reference()["times"] == 1
        assert following.first() is designator
        assert [solution["times"] for solution in designator.solutions()] == [0, 1, 2]
        assert following.next_solution().next_solution() is None
    with pytest.raises(DesignatorError, match="unknown type 'waving'"):
        MotionDesignator([("type", "waving")]).reference()


def test_what_the_only_resolver_of_a_type_says_is_what_the_plan_gets() -> None:
    def resolver(designator: MotionDesignator) -> object:
        if designator.type == "waving":
            raise DesignatorError("waving takes the slot hand", type="waving", slot="hand")
        return None

    with MotionDesignator.resolvers.added(resolver):
        with pytest.raises(DesignatorError, match="waving takes the slot hand"):
            MotionDesignator([("type", "waving")]).reference()
        with pytest.raises(DesignatorError, match="unknown type 'weaving'"):
            MotionDesignator([("type", "weaving")]).reference()


def test_moving_without_orientation_keeps_that_of_the_robot() -> None:
    with BulletWorld() as world:
        world.robot = Object("pr2", "robot", "pr2.urdf", [0, 0, 0], [0, 0, 0.6, 0.8])
        plain = MotionDesignator([("type", "moving"), ("target", [1, 0, 0])])
        assert plain.reference()["orientation"] == pytest.approx([0, 0, 0.6, 0.8])
        turned = MotionDesignator([("type", "moving"), ("target", [1, 0, 0]), ("orientation", [0, 0, 0, 1])])
        assert [s["orientation"][3] for s in turned.solutions()] == pytest.approx([1, 0.8])


def test_slots_are_found_with_hyphens_and_with_underscores() -> None:
    for name in ("object-type", "object_type"):
        designator = MotionDesignator([("type", "detecting"), (name, "milk")])
        assert designator.prop_value("object_type") == designator.prop_value("object-type") == "milk"
        solution = designator.reference()
        assert solution == {"cmd": "detecting", "object-type": "milk"}
        assert solution["object_type"] == solution.get("object_type") == solution["object-type"] == "milk"
        assert "object_type" in solution
        assert solution.get("objekt_type") is None
        with pytest.raises(KeyError):
            solution["objekt_type"]
        with pytest.raises(AttributeError, match=r'write solution\["object_type"\]'):
            _ = solution.object_type
        assert designator.copy({"object_type": "cup"}).reference()["object-type"] == "cup"
    for name in ("left-arm", "left_arm"):
        posture = MotionDesignator([("type", "move-arm-joints"), (name, "park")])
        assert posture.resources().moves == {"left-arm"}
        assert posture.reference()["left_arm"] == "park"


def test_an_object_as_a_target_is_its_middle_or_refused_with_the_places_at_it() -> None:
    with BulletWorld() as world:
        world.robot = Object("pr2", "robot", "pr2.urdf")
        plate = Object("plate", "plate", "plate.stl", [1, 0, 0.8], [0, 0, 0.6, 0.8])
        low, high = plate.get_AABB()
        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        pointed = [motions.looking(target=plate), motions.move_tcp(target=plate)]
        assert [each.reference()["target"] for each in pointed] == [middle, middle]
        with pytest.raises(DesignatorError, match=r"expected .*LocationDesignator\(reachable_for=") as raised:
            motions.moving(target=plate).reference()
        assert str(raised.value.__cause__).count("LocationDesignator") == 2
        with pytest.raises(DesignatorError, match=r"LocationDesignator\(on="):
            motions.place(object=plate, target=plate).reference()
        with pytest.raises(DesignatorError, match="where the robot can stand"):
            actions.navigating(target=plate).check()
        (aimed,) = actions.looking(target=plate).solutions()
        assert aimed["target"] == middle
        put = ACTIONS["placing"].checked({"object": plate, "target": plate})["target"]
        assert [body for body, _ in put.surfaces()] == [plate]


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        ([("target", [1, 0, 1])], "no slot type"),
        ([("type", "loking"), ("target", [1, 0, 1])], "did you mean looking"),
        ([("type", "accessing"), ("drawer-joint", "j")], "drawer-handle, part-of"),
        ([("type", "detecting"), ("object", "milk"), ("object-type", "milk")], "given twice"),
        ([("type", "moving"), ("target", [1, 0, float("nan")])], "target"),
        ([("type", "place"), ("object", "milk"), ("target", [1, 0, 1])], "an Object of a world"),
        ([("type", "move-arm-joints")], "left-arm or right-arm"),
        ([("type", "pick-up"), ("object", None)], "missing slot object"),
    ],
)
def test_errors_name_the_slots_of_the_type(slots: list[tuple[str, object]], message: str) -> None:
    with pytest.raises(DesignatorError, match=message) as raised:
        MotionDesignator(slots).reference()
    assert raised.value.takes


def test_slots_and_solutions_are_copies() -> None:
    target = [1.0, 0.0, 0.0]
    designator = MotionDesignator([("type", "moving"), ("target", target), ("orientation", [0, 0, 0, 1])])
    target[0] = 9.0
    assert designator.prop_value("target") == [1.0, 0.0, 0.0]
    designator.prop_value("target")[0] = 9.0
    solution = designator.reference()
    solution["target"][0] = 9.0
    assert designator.reference()["target"] == [1.0, 0.0, 0.0]
    assert designator.copy().reference()["target"] == [1.0, 0.0, 0.0]


def test_slots_may_hold_values_that_cannot_be_printed() -> None:
    class Shy:
        def __repr__(self) -> str:
            raise ZeroDivisionError

    shy = Shy()
    endless: list[object] = []
    endless.append(endless)
    designator = MotionDesignator([("type", "x"), ("shy", shy), ("endless", endless)])
    assert designator.prop_value("shy") is shy
    assert len(designator.prop_value("endless")) == 1


def test_only_designators_can_be_equated() -> None:
    with pytest.raises(BadArgument, match="another designator"):
        MotionDesignator([("type", "x")]).equate("x")
    assert not MotionDesignator([("type", "x")]).equal(None)


@pytest.mark.parametrize("garbage", [5, "abc", [5], {"cmd": "looking"}])
def test_a_resolver_that_returns_no_solutions_is_refused_by_name(garbage: object) -> None:
    def careless(_: MotionDesignator) -> object:
        return garbage

    with MotionDesignator.resolvers.added(careless), pytest.raises(BadArgument, match="careless"):
        looking().reference()


def test_only_process_modules_can_be_registered_and_chosen(scene: BulletWorld) -> None:
    with pytest.raises(BadArgument, match="process modules by cmd"):
        register("pr2", "elsewhere", {"looking": 5})

    def careless(_: MotionDesignator) -> object:
        return 5

    with ProcessModule.resolvers.added(careless), pytest.raises(BadArgument, match="careless"):
        ProcessModule.perform(looking())


def test_a_resolver_may_wait_for_a_thread_that_resolves_the_same_designator() -> None:
    asked: list[object] = []

    def waiting(designator: MotionDesignator) -> list[dict[str, object]] | None:
        if threading.current_thread() is not threading.main_thread():
            return None
        thread = threading.Thread(target=lambda: asked.append(designator.reference()["cmd"]))
        thread.start()
        thread.join(20)
        return [{"cmd": "mine"}]

    designator = looking()
    with MotionDesignator.resolvers.added(waiting):
        assert designator.reference()["cmd"] == "looking", "the first to find one decides"
    assert asked == ["looking"]
    assert designator.reference()["cmd"] == "looking"


def test_eight_threads_find_the_same_solutions() -> None:
    found: list[list[object]] = []
    start = threading.Barrier(8)

    def three(designator: MotionDesignator) -> Iterator[dict[str, object]]:
        yield from ({"cmd": f"number {number}"} for number in range(3))

    designator = looking()

    def collect() -> None:
        start.wait()
        found.append([solution["cmd"] for solution in designator.solutions()])

    with MotionDesignator.resolvers.added(three):
        threads = [threading.Thread(target=collect) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert found == [["number 0", "number 1", "number 2", "looking"]] * 8


@pytest.mark.parametrize(
    ("slots", "end"),
    [
        ({"type": "pick-up", "objet": "milk"}, "unknown slot objet; did you mean object?"),
        ({"type": "place", "object": 3}, "expected an Object of a world, or an ObjectDesignator"),
        ({"type": "moving", "target": "island"}, "expected 3 finite numbers x, y, z, or a LocationDesignator"),
        ({"type": "looking", "target": "island"}, "x, y, z, or a LocationDesignator or an ObjectDesignator"),
    ],
)
def test_usage_errors_begin_and_end_with_the_error_and_name_all_kinds_of_values(slots: dict, end: str) -> None:
    with pytest.raises(DesignatorError) as raised:
        MotionDesignator(slots).reference()
    first, *listed, last = str(raised.value).splitlines()
    assert first == last
    assert last.endswith(end)
    assert "  type (required): " in "\n".join(listed)
