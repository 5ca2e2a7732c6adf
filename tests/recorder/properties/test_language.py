"""The language of properties: what it takes, what it refuses, and that nothing of it is executed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from recorder.properties import BadProperty, parse, parse_file
from recorder.properties.expressions import PropertyExpression, Scene, plain
from recorder.records import Attachment, BodyState, LoadBody
from recorder.records.fold import FoldedBody, FoldedWorld

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = """
[arms.left]
base_link = "torso"
tool_frame = "left_tool"
[arms.right]
base_link = "torso"
tool_frame = "right_tool"
"""


@pytest.fixture
def scene() -> Scene:
    world = FoldedWorld("lab")
    world.robot = "pr2"
    tilted = (math.sin(math.radians(10)), 0, 0, math.cos(math.radians(10)))
    for name, position, orientation in (
        ("pr2", (0, 0, 0), (0, 0, 0, 1)),
        ("milk", (3, 4, 0.5), tilted),
        ("milk carton", (0, 0, 1), (0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4))),
    ):
        world.bodies[name] = FoldedBody(LoadBody(body=name, robot_description=ROBOT if name == "pr2" else ""))
        world.bodies[name].set_state(BodyState(body=name, position=position, orientation=orientation))
    world.bodies["pr2"].joints["head_pan"] = 0.3
    held = Attachment(
        carrier="pr2", carrier_link="left_tool", body="milk", position=(0, 0, 0), orientation=(0, 0, 0, 1)
    )
    world._attach([held])
    return Scene({"lab": world})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("milk.z", 0.5),
        ("milk.z * 2 + 1", 2.0),
        ("milk.position[0]", 3.0),
        ("milk.z > 40 cm", True),
        ("milk.z > 500 mm", False),
        ("0 < milk.z < 0.5 m", False),
        ("distance(robot, milk) < 6", True),
        ("distance(milk, [3, 4, 0]) == 0.5", True),
        ("holding(left)", "milk"),
        ("holding() is milk", True),
        ("holding(right) is None", True),
        ("holding(left) in (milk, pr2)", True),
        ("holding(left) is not 'milk carton'", True),
        ("milk.carrier == pr2", True),
        ("tilt(milk) > 19 deg and tilt(milk) < 21 deg", True),
        ("upright(milk)", False),
        ("upright(milk, 21 deg)", True),
        ("angle('milk carton'.yaw, -270 deg) < 1e-6", True),
        ("angle(pr2, milk_carton) > 1.57", True),
        ("pr2.head_pan == 0.3", True),
        ("lab['milk carton'].z", 1.0),
        ("not (milk.z > 1 or pr2.x > 1)", True),
        ("count(milk.z > 0.4) == 1", True),
        ("count([milk.z > 0.4, milk.z > 1, milk.x > 1]) == 2", True),
        ("count(upright('milk*'))", 1),
        ("count(not upright('milk*'))", 1),
        ("upright('milk*')", True),
        ("not upright('milk*')", False),
        ("len(milk.position)", 3),
        ("milk.speed < 5 mm/s and 1 m/s == 100 cm/s", True),
        ("degrees(180 deg/s) * 1 == 180", True),
    ],
)
def test_expressions_have_values(scene: Scene, text: str, value: object) -> None:
    found = plain(PropertyExpression(text).value(scene))
    assert found == (pytest.approx(value) if isinstance(value, float) else value)


@pytest.mark.parametrize(
    ("text", "margin"),
    [
        ("milk.z > 0.4", 0.1),
        ("milk.z > 0.4 and milk.x < 3.05", 0.05),
        ("milk.z > 0.4 or milk.x < 5", 2.0),
        ("not milk.z > 0.4", -0.1),
        ("upright(milk, 30 deg)", math.radians(10)),
        ("holding(left) is milk", math.inf),
    ],
)
def test_conditions_have_margins(scene: Scene, text: str, margin: float) -> None:
    assert PropertyExpression(text).truth(scene).margin == pytest.approx(margin)


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("upright(milk, 10)", "10 is an angle of more than 2 pi rad; write 10 deg, or 10 rad"),
        ("milk.yaw < -90", "write 90 deg, or 90 rad"),
        ("kitchen.door_joint < 45", "write 45 deg"),
        ("milk.z < 3 deg", "milk.z and 3 deg have different units"),
        ("milk.z < 5 mm/s", "milk.z and 5 mm/s have different units"),
        ("upright(milk, 10 deg, 3)", "upright takes 1 to 2 arguments, not 3"),
        ("uprigth(milk)", r"there is no function uprigth; did you mean upright\?"),
        ("milk.z >", "it isn't an expression"),
        ("always", "it has no expression"),
        ("always milk.z > 1 never milk.z > 2", "'always' and 'never' can't be combined"),
        ("milk.z > 1 always milk.z > 2", "two expressions"),
        ("eventually milk.z > 1 within 2 m", "a time such as 2 s must follow 'within', not '2 m'"),
        ("sum([milk.z > 1, milk.x > 1]) == 1", r"milk.z > 1 is a condition, not a number; count\(...\) is the number"),
        ("len(on('cup*', table)) == 3", r"on\('cup\*', table\) is a condition, not a number"),
        ("round(upright(milk)) == 1", r"upright\(milk\) is a condition"),
        ("(milk.z > 1) + (milk.x > 1) == 2", "milk.z > 1 is a condition"),
        ("on('cup*', table) == 3", r"on\('cup\*', table\) is a condition"),
        ("count(upright('cup*') and on('cup*', table)) > 1", "count takes a single condition with a pattern"),
        ("milk.z > 1 during", "an expression is missing after 'during'"),
        ("milk.z > 1 during task:", "the name of a task is missing"),
        ("eventually milk.z > 1 until milk.z > 2", "'until' and 'eventually' can't be combined"),
    ],
)
def test_mistakes_are_refused_with_their_cause(text: str, cause: str) -> None:
    with pytest.raises(BadProperty, match=cause):
        parse(text)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "(lambda: 1)()",
        "[x for x in (1, 2)]",
        "milk.__class__()",
        "open('/etc/passwd')",
        "f'{milk}'",
        "milk.z if milk.x else 1",
        "(milk := 1)",
        "max(milk.z, key=abs)",
        "1 << 2",
        "9 ** milk.f()",
        "x" * 3000,
        "(" * 1500,
    ],
)
def test_python_beyond_the_language_is_refused(text: str) -> None:
    with pytest.raises(BadProperty):
        PropertyExpression(text)


@pytest.mark.parametrize("text", ["9 ** 9 ** 9 ** 9 > 1", "'a' * 9 == 1", "milk.z / 0 > 1", "(-1) ** 0.5 > 1"])
def test_calculations_without_a_result_have_no_value(scene: Scene, text: str) -> None:
    with pytest.raises(LookupError):
        PropertyExpression(text).truth(scene)


def test_words_about_time_may_come_in_any_order() -> None:
    one = parse("always upright(milk) during task:place within 2 s")
    other = parse("during task:place, within 2000 ms, always upright(milk)")
    assert [each.body.text for each in (one, other)] == ["upright(milk)"] * 2
    assert one.within == other.within == 2.0
    assert one.during is not None
    assert one.during == other.during
    quoted = parse("never contact('after', \"at end\") before (milk.z > 1 and milk.x > 2)")
    assert (quoted.kind, quoted.body.text) == ("never", "contact('after', \"at end\")")


def test_a_file_has_a_property_on_each_line(tmp_path: Path) -> None:
    file = tmp_path / "table.properties"
    file.write_text(
        "# the table\n\nalways milk.z > 0.5  # above the counter\nat end milk['#'].z > 1\n", encoding="utf-8"
    )
    first, second = parse_file(file)
    assert (first.text, first.source) == ("always milk.z > 0.5", "table.properties:3")
    assert second.text == "at end milk['#'].z > 1"
    file.write_text("always milk.z >\n", encoding="utf-8")
    with pytest.raises(BadProperty, match=r"table\.properties:1: milk\.z >: it isn't an expression"):
        parse_file(file)
    file.write_text("# nothing\n", encoding="utf-8")
    with pytest.raises(BadProperty, match="it has no properties"):
        parse_file(file)
