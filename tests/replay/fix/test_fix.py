"""Repairs of failed plans: edits with which the whole run succeeds."""

from __future__ import annotations

import ast
import json
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

import replay
from recorder.records import Mutation
from replay.cli.main import main
from replay.fix.edits import Edit, Editor
from replay.fix.search import changed_goal, changed_place, reaches_goal
from tests.replay.fix.test_written_test import PLAN as STACKING, recorded

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.tasks import Node
    from replay.file.record_reader import RecordReader

#: It fails: the height is in centimetres.
PLAN = """import random

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure

HEIGHT = 20
GAP = 0.1


def target(number):
    return [GAP * number, 0, HEIGHT]


with BulletWorld() as world:
    cups = [Object(f"cup {number}", "cup", "cup.stl", [1, number, 0]) for number in range(2)]
    for number, cup in enumerate(cups):
        cup.set_position(target(number))
        if not 0.1 < cup.get_position()[2] < 0.5:
            raise PlanFailure(f"{cup.name} is too high")
"""


def fixed(log: Path, *options: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, object]]:
    code = main(["fix", str(log), "--json", "--keep", str(log.parent), *options])
    printed = capsys.readouterr()
    return code, json.loads(printed.out) if printed.out else {"err": printed.err}


@pytest.mark.slow
def test_the_wrong_number_is_repaired_and_the_repair_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, plan = recorded(tmp_path, PLAN), tmp_path / "stacks.py"
    code, found = fixed(log, capsys=capsys)
    assert code == 0
    repair = found["repairs"][0]
    assert "-HEIGHT = 20\n+HEIGHT = 0.2" in repair["diff"]
    assert (repair["seeds"], repair["elsewhere"], repair["mark"]) == (5, 3, "")
    with replay.open(repair["recording"]) as success:
        assert success.why().run.outcome == "succeeded"
    plan.write_text(PLAN + "# edited\n")
    assert main(["fix", str(log), "--apply", "--keep", str(tmp_path)]) == 2  # it isn't what was recorded
    assert plan.read_text().endswith("# edited\n")
    plan.write_text(PLAN)
    assert main(["fix", str(log), "--apply", "--keep", str(tmp_path)]) == 0
    assert plan.read_text() == PLAN.replace("HEIGHT = 20", "HEIGHT = 0.2")
    assert (tmp_path / "stacks.py.orig").read_text() == PLAN


@pytest.mark.slow
def test_a_repair_that_fits_only_its_seed_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn = PLAN.replace("HEIGHT = 20", "random.seed() if False else None\nHEIGHT = 20").replace(
        "            raise",
        '            raise PlanFailure("high")\n        if random.random() > 0.2:\n            raise',
    )
    log = recorded(tmp_path, drawn.replace("HEIGHT = 20", "HEIGHT = 0.2"))
    code, found = fixed(log, "--budget", "21", capsys=capsys)
    assert found["runs"] <= 21
    assert code == (0 if found["repairs"] else 1)
    assert all(each["mark"] for each in found["repairs"] if not each["seeds"])


@pytest.mark.slow
def test_properties_are_the_goal_of_a_plan_that_raises_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = PLAN.replace("raise PlanFailure(", "print(")
    log = recorded(tmp_path, quiet)
    code, answer = fixed(log, capsys=capsys)
    assert code == 2
    assert "--holds" in str(answer["err"])
    assert fixed(log, "--holds", "at end cup is z", capsys=capsys)[0] == 2
    code, found = fixed(log, "--holds", "at end 'cup 1'.z > 0.1 and 'cup 1'.z < 0.5", capsys=capsys)
    assert code == 0
    assert "+HEIGHT = 0.2" in found["repairs"][0]["diff"]


@pytest.mark.slow
def test_without_a_repair_the_answer_says_what_was_tried(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path, 'raise ValueError("never")\n')
    assert main(["fix", str(log), "--holds", "at end cup.z > 1"]) == 1  # the cup isn't loaded before the failure
    assert capsys.readouterr().out.startswith("no repair found; tried ")


@pytest.mark.costly
def test_what_a_plan_places_has_to_stay_at_its_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = fixed(recorded(tmp_path, STACKING), capsys=capsys)
    assert code == 0
    assert "place is done" in str(found["asked"])
    assert "+WHERE = [0.5, 0.2, 0.83]" in found["repairs"][0]["diff"]
    assert not found["repairs"][0]["mark"]  # the scene suggests that the number is in centimetres


def test_edits_stay_at_one_place_and_leave_no_statement_out() -> None:
    text = 'x = [1, 0, 0, 1]\nif a < b and not c:\n    do("left", d / 2)\n    go("right")  # é\n'
    editor = Editor(text)
    edited = {line: {each.text for each in editor.edits(line, [["left", "right"]])} for line in (1, 2, 3, 4)}
    assert text.replace("[1, 0, 0, 1]", "[0, 0, 1, 1]") in edited[1]
    assert text.replace("a < b", "a > b") in edited[2]
    assert text.replace("not c", "c") in edited[2]
    assert text.replace('"left"', "'right'") in edited[3]
    assert text.replace("d / 2", "d * 2") in edited[3]
    assert 'x = [1, 0, 0, 1]\nif a < b and not c:\n    go("right")  # é\n    do("left", d / 2)\n' in edited[4]
    for texts in edited.values():
        assert all("do(" in each and "go(" in each and "x = " in each for each in texts)


def test_no_statement_comes_behind_the_end_of_its_block() -> None:
    text = """
def lay(things):
    for thing in things:
        go(thing)
        if thing.full:
            spill(thing)
            continue
        put(thing)
    wash(things)
    return things
"""
    editor = Editor(text)
    edits = [edit.text for line in range(1, text.count("\n") + 1) for edit in editor.edits(line)]
    assert any(edit.index("wash(") < edit.index("for thing") for edit in edits), "statements are moved"
    for node in (node for edit in edits for node in ast.walk(ast.parse(edit))):
        block = getattr(node, "body", [])
        assert not any(isinstance(each, ast.Return | ast.Continue) for each in block[:-1]), ast.unparse(node)


def test_an_edit_that_makes_two_alternatives_equal_is_marked() -> None:
    edits = [*Editor('arm = "left" if near else "right"\nother = "left"\n').edits(1, [["left", "right"]])]
    found = {each.text.splitlines()[0]: each.chance for each in edits}
    assert found["arm = 'right' if near else \"right\""]
    assert not any(each.chance for each in Editor('arm = "left"\n').edits(1, [["left", "right"]]))


#: A plan with a mistake, and the same plan without it.
MISTAKES = {
    "aliasing": ("slots = [[1, y]] * count\n", "slots = [[1, y] for _ in range(count)]\n"),
    "default": (
        "def line(names, used=[]):\n    used.append(names)\n",
        "def line(names, used=None):\n    used = [] if used is None else used\n    used.append(names)\n",
    ),
    "late binding": (
        "for kind in kinds:\n    jobs.add(lambda: go(kind))\n",
        "for kind in kinds:\n    jobs.add(lambda kind=kind: go(kind))\n",
    ),
    "shadowing": (
        "def put(goal):\n    for goal in ways:\n        go(goal)\n    place(goal)\n",
        "def put(goal):\n    for goal_2 in ways:\n        go(goal_2)\n    place(goal)\n",
    ),
    "branches": (
        "if a in b:\n    go(1)\nelif a in c:\n    go(2)\n    go(3)\n",
        "if a in c:\n    go(2)\n    go(3)\nelif a in b:\n    go(1)\n",
    ),
    "swallowed error": (
        "for arm in arms:\n    try:\n        take(arm)\n    except Error:\n        pass\n    go()\n",
        "for arm in arms:\n    try:\n        take(arm)\n    except Error:\n        continue\n    go()\n",
    ),
    "success": (
        "for arm in arms:\n    try:\n        take(arm)\n    except Error:\n        print()\n",
        "for arm in arms:\n    try:\n        take(arm)\n        break\n    except Error:\n        print()\n",
    ),
    "precedence": ("y = a + b / 2\n", "y = (a + b) / 2\n"),
    "degrees": ("import math\nturn(sin(degrees / 2))\n", "import math\nturn(sin(math.radians(degrees) / 2))\n"),
    "bounds": ("for i in range(1, len(x)):\n    go(i)\n", "for i in range(len(x)):\n    go(i)\n"),
    "reset": (
        "y = 0\nfor row in rows:\n    y += 1\n    go(y)\n",
        "for row in rows:\n    y = 0\n    y += 1\n    go(y)\n",
    ),
    "early return": (
        "def f():\n    for a in b:\n        go(a)\n        return a\n",
        "def f():\n    for a in b:\n        go(a)\n    return a\n",
    ),
    "second world": (
        "world = BulletWorld()\nspare = BulletWorld()\nworld.go()\n",
        "world = BulletWorld()\nworld.go()\n",
    ),
    "undefined name": ("cup = Object(1)\ngo(mug)\n", "cup = Object(1)\ngo(cup)\n"),
    "item twice": (
        'Object("cup", "cup")\nObject("jug", "jug")\nnames = ["cup", "cup"]\ngo(names)\n',
        'Object("cup", "cup")\nObject("jug", "jug")\nnames = ["cup", \'jug\']\ngo(names)\n',
    ),
    "lost update": ("y = 0\nfor a in b:\n    y = 1\ngo(y)\n", "y = 0\nfor a in b:\n    y += 1\ngo(y)\n"),
    "lost items": (
        "found = []\nfor a in b:\n    found = get(a)\ngo(found)\n",
        "found = []\nfor a in b:\n    found += get(a)\ngo(found)\n",
    ),
    "lost value": ("fluent.set_value(2)\n", "fluent.set_value(fluent.get_value() + 2)\n"),
    "first item": ("go(box[-1])\n", "go(box[0])\n"),
    "forgotten call": ("if row.copy:\n    go()\n", "if row.copy():\n    go()\n"),
    "dropped call": ("def go():\n    pass\ngo\n", "def go():\n    pass\ngo()\n"),
    "early call": ("def watch():\n    pass\nwork(watch())\n", "def watch():\n    pass\nwork(watch)\n"),
    "dropped result": ("import m\nm.replace(job, a=1)\n", "import m\njob = m.replace(job, a=1)\n"),
    "no result": ("def f(a):\n    a + 1\ngo(f(2))\n", "def f(a):\n    return a + 1\ngo(f(2))\n"),
    "sorted result": ("x = y.sort(key=len)\n", "x = sorted(y, key=len)\n"),
    "sort key": (
        "class Job:\n    def __init__(self):\n        self.row = 1\nx.sort()\n",
        "class Job:\n    def __init__(self):\n        self.row = 1\nx.sort(key=lambda each: each.row)\n",
    ),
    "unsorted groups": (
        "for a, b in groupby(x, f):\n    go(a)\n",
        "for a, b in groupby(sorted(x, key=f), f):\n    go(a)\n",
    ),
    "near name": ("from math import floor\ngo(floor(x))\n", "from math import floor, ceil\ngo(ceil(x))\n"),
    "block": (
        "from pycram.language import seq\nwith seq as s:\n    s(f)\n",
        "from pycram.language import seq, par\nwith par as s:\n    s(f)\n",
    ),
    "cache": ("@lru_cache\ndef f(a):\n    return a\n", "def f(a):\n    return a\n"),
    "changed while iterated": ("for a in b:\n    b.remove(a)\n", "for a in list(b):\n    b.remove(a)\n"),
    "formatted text": ("for a in b:\n    go('{a}.stl')\n", "for a in b:\n    go(f'{a}.stl')\n"),
    "swapped arguments": ("def f(a, b):\n    pass\nf(x, y)\n", "def f(a, b):\n    pass\nf(y, x)\n"),
    "forgotten slot": ("go(cup, arm=left)\ngo(mug)\n", "go(cup, arm=left)\ngo(mug, arm=left)\n"),
    "too shallow": ("for a in b:\n    go(a)\nn += 1\n", "for a in b:\n    go(a)\n    n += 1\n"),
    "index": ("go(x[i])\n", "go(x[i - 1])\n"),
    "membership": ("if a == 'x' or 'y':\n    go(a)\n", "if a in ('x', 'y'):\n    go(a)\n"),
    "late value": (
        "for a in b:\n    x = a[0]\n    jobs.add(lambda: go(x))\n",
        "for a in b:\n    x = a[0]\n    jobs.add(lambda x=x: go(x))\n",
    ),
    "read twice": (
        "def f(b):\n    return (a for a in b)\n",
        "def f(b):\n    return [a for a in b]\n",
    ),
    "read from the start": (
        "self.ways = ways\ngo(next(iter(self.ways)))\n",
        "self.ways = iter(ways)\ngo(next(iter(self.ways)))\n",
    ),
    "read to the first success": ("any(perform(a) for a in b)\n", "any([perform(a) for a in b])\n"),
    "half angle": ("x = [0, 0, sin(a), cos(a)]\n", "x = [0, 0, sin(a / 2), cos(a / 2)]\n"),
    "half angle of some lines": (
        "def f(a):\n    z = sin(a)\n    return z, cos(a)\n",
        "def f(a):\n    z = sin(a / 2)\n    return z, cos(a / 2)\n",
    ),
    "all alike": ("x = int(a / 2), int(b / 2)\n", "x = floor(a / 2), floor(b / 2)\n"),
    "whole height": ("z = top + height\n", "z = top + height / 2\n"),
    "digits": (
        "a, b = line.split()\nspot.row = b\n",
        "a, b = line.split()\nspot.row = float(b)\n",
    ),
    "sorted digits": (
        "import csv\nrows.sort(key=lambda row: row['at'])\n",
        "import csv\nrows.sort(key=lambda row: float(row['at']))\n",
    ),
    "other key": ("go({'spots': 1})\nx = a['spot']\n", "go({'spot': 1})\nx = a['spot']\n"),
    "one of two units": (
        "go({'a': f(wide=radians(10)), 'b': f(wide=50)})\n",
        "go({'a': f(wide=radians(10)), 'b': f(wide=radians(50))})\n",
    ),
    "equal keys": (
        "class Row:\n    name: str\n    kind: str\nx = {row.kind: row for row in rows}\n",
        "class Row:\n    name: str\n    kind: str\nx = {row.name: row for row in rows}\n",
    ),
    "kept value": ("old = new\nWorld.robot = new\n", "old = World.robot\nWorld.robot = new\n"),
    "plain code in a block": (
        "with seq:\n    perform(a)\n    note(b)\n",
        "with seq as block:\n    perform(a)\n    block(note, b)\n",
    ),
    "missing value": ("fluent.set_value(False)\n", "fluent.set_value(None)\n"),
    "zero": ("x = row.get(a) or 3\n", "x = row.get(a, 3)\n"),
    "receiver": ("cup.attach(tray)\n", "tray.attach(cup)\n"),
    "swapped question": ("x = supporting(cup, tray)\n", "x = supporting(tray, cup)\n"),
    "inexact sum": (
        "while y < end:\n    go(y)\n    y += step\n",
        "while y < end - step / 2:\n    go(y)\n    y += step\n",
    ),
    "read before a change": (
        "x = cup.get_position()\nperform(a)\nperform(b)\ngo(x)\n",
        "perform(a)\nperform(b)\nx = cup.get_position()\ngo(x)\n",
    ),
    "read in a block": (
        "with par:\n    perform(a)\n    x = cup.get_position()\n    perform(b)\ngo(x)\n",
        "with par:\n    perform(a)\n    perform(b)\nx = cup.get_position()\ngo(x)\n",
    ),
    "return in a branch": (
        "def f(a):\n    if a:\n        x = 1\n    else:\n        x = 2\n        return x\n",
        "def f(a):\n    if a:\n        x = 1\n    else:\n        x = 2\n    return x\n",
    ),
    "shared by a class": (
        "class Tray:\n    jobs = []\n    def __init__(self, x):\n        self.x = x\n",
        "class Tray:\n    def __init__(self, x):\n        self.jobs = []\n        self.x = x\n",
    ),
    "other case": ("a, b = line.split()\nx[a] = 1\n", "a, b = line.split()\nx[a.lower()] = 1\n"),
    "narrow handler": (
        "from pycram.failures import PlaceFailed, PlanFailure\ntry:\n    go()\nexcept PlaceFailed:\n    print()\n",
        "from pycram.failures import PlaceFailed, PlanFailure\ntry:\n    go()\nexcept PlanFailure:\n    print()\n",
    ),
    "row and column": ("x, y = a // n, a // n\n", "x, y = (a // n, a % n)\n"),
    "alike in a list": ("x = [int(a / 2), int(b / 2)]\n", "x = [int(a // 2), int(b // 2)]\n"),
    "counted after the loop": (
        "y = 0\nfor a in b:\n    go(y)\ny += 1\n",
        "y = 0\nfor a in b:\n    go(y)\n    y += 1\n",
    ),
    "not performed": (
        "from pycram.motion_designators import moving\nmoving(target=x)\n",
        "from pycram.motion_designators import moving\nperform(moving(target=x))\n",
    ),
    "defaults last": ("x = {**job, **usual}\n", "x = {**usual, **job}\n"),
    "read after a change": (
        "perform(a)\nx = cup.get_position()\ngo(x)\n",
        "x = cup.get_position()\nperform(a)\ngo(x)\n",
    ),
    "lost list": ("x.get(a, []).append(b)\n", "x.setdefault(a, []).append(b)\n"),
    "local variable": (
        "class A:\n    def __init__(self):\n        self.load = None\n    def take(self, body):\n        load = body\n",
        "class A:\n    def __init__(self):\n        self.load = None\n    def take(self, body):\n        self.load = body\n",
    ),
    "rotation": ("x = a + u * cos(yaw) + v * sin(yaw)\n", "x = a + u * cos(yaw) - v * sin(yaw)\n"),
    "conditional": ("z = top + h if up else low\n", "z = top + (h if up else low)\n"),
    "wait": ("ready.wait_for()\n", "(ready == True).wait_for()\n"),
    "type": ("go(cup.type)\n", "go(cup)\n"),
    "first sum": ("x = list(accumulate(widths))\n", "x = list(accumulate(widths, initial=0))\n"),
    "method's arguments": ("graph.add(one, other)\n", "graph.add(other, one)\n"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_typical_mistakes_have_an_inverse_without_doubt(kind: str) -> None:
    before, after = MISTAKES[kind]
    editor = Editor(before)
    edits = [edit for line in range(1, before.count("\n") + 1) for edit in editor.edits(line)]
    found = [edit for edit in edits if edit.text == after]
    assert not min(found).asks
    assert not min(found).chance


def test_flags_and_exchanged_values_are_doubted() -> None:
    for before, after in (
        ("go(close=False)\n", "go(close=True)\n"),
        ("x = {'a': 1, 'b': -1}\n", "x = {'a': -1, 'b': 1}\n"),
    ):
        assert {edit.chance for edit in Editor(before).edits(1) if edit.text == after} == {True}, before


def test_a_slip_is_evidence_only_for_an_edit_that_mends_it() -> None:
    text = "def grouped(rows, key):\n    return {a: list(b) for a, b in groupby(rows, key=key)}\n"
    found = {"sorted(" in edit.text: edit.evidence(text) for edit in Editor(text).edits(2)}
    assert "neighbours" in found[True]
    assert not found[False], "another edit of that line"
    text = "def turned(yaw):\n    go(sin(yaw / 4), 0, cos(yaw / 4), limits[1])\n"
    assert not any(edit.evidence(text) for edit in Editor(text).edits(2)), "no other number supports an edit"


def test_a_condition_of_a_check_changes_only_if_it_is_always_true() -> None:
    text = "def put(row):\n    if row.full{}:\n        raise ValueError(row)\n    row.full()\n"
    assert [edit.text for edit in Editor(text.format("")).edits(2)] == [text.format("()")]
    assert not [*Editor(text.format("()")).edits(2)]


def test_names_without_a_value_yet_replace_no_name() -> None:
    text = "def f(one):\n    go(one)\n    two = one\n    go(two)\n"
    names = {line: {each.what for each in Editor(text).edits(line)} for line in (2, 4)}
    assert "two instead of one" not in names[2]
    assert "one instead of two" in names[4]


def test_a_call_of_the_plan_is_inserted_also_with_an_unused_name() -> None:
    text = (
        "from pycram import perform\nHERE, THERE = [0], [1]\nNEAR = [1, 2]\nFAR = [3, 4]\n"
        "def go(to):\n    perform(to)\ngo(NEAR)\nperform(pick_up(1))\nperform(place(1))\n"
    )
    inserted = [edit.what for edit in sorted(Editor(text).insertions(9))]
    assert inserted == ["go(FAR) before line 9", "go(NEAR) before line 9"]


def test_values_for_assertions_and_prints_stay_unchanged() -> None:
    text = (
        "def gap(a):\n    return a[0] - 1\nput(cup)\ndx = abs(cup.get_position()[0] - 2)\nnear = dx < gap(cup)\n"
        "assert near\nfor name in names[1:]:\n    y = where(name)[1]\n    print(y - 1)\nx = cup.get_position()[0]\nprint(x)\ngo(x)\n"
    )
    editor = Editor(text)
    assert not [edit for line in (2, 4, 5, 7, 8, 9) for edit in editor.edits(line) if not edit.what.startswith("line")]
    assert [edit for edit in editor.edits(10) if not edit.what.startswith("line")]


def test_other_scales_and_swapped_axes_are_doubted_without_a_number_that_suggests_them() -> None:
    editor = Editor(
        "LEFT, RIGHT = 0.4, 1.6\nHEIGHT = 80\nput([LEFT, RIGHT, HEIGHT])\ny = LEFT / RIGHT\nset_gravity(-9.8)\n"
    )
    doubted = {
        edit.text.splitlines()[edit.line - 1]: edit.chance for line in range(1, 6) for edit in editor.edits(line)
    }
    for text, chance in {
        "LEFT, RIGHT = 0.004, 1.6": True,
        "HEIGHT = 0.8": False,
        "put([RIGHT, LEFT, HEIGHT])": True,
        "y = LEFT * RIGHT": True,
        "y = LEFT // RIGHT": True,
        "set_gravity(-0.098)": True,
    }.items():
        assert doubted[text] == chance


def test_another_target_changes_what_is_asked_for() -> None:
    def motion(target: list[float]) -> Node:
        return cast(
            "Node", SimpleNamespace(kind="motion", name="place", parameters={"target": target}, around=lambda: ())
        )

    done, failed = [motion([1, 0, 0])], motion([8, 0, 0])
    value, operator = Edit(0, 1, "", "", asks=True), Edit(0, 1, "", "")
    mark = changed_goal(done, [*done, motion([0.8, 0, 0])], failed, value)
    assert mark == "it changes the task: the target [8, 0, 0] becomes [0.8, 0, 0]"
    assert changed_goal(done, [motion([2, 0, 0]), failed], failed, value)
    assert not changed_goal(done, [*done, failed], failed, value)
    assert not changed_goal(done, [*done, motion([0.8, 0, 0])], failed, operator)


def test_a_position_seen_from_the_robot_becomes_one_in_the_world_and_edits_of_used_positions_come_first() -> None:
    editor = Editor("drive([-0.3, 1, 0])\nput([[0.5, 0.2, 0.9], [0.6, 0.1, 0.87]])\n")
    assert any("[0.3, 1.1, 0.87]" in edit.text and edit.chance for edit in editor.edits(2))
    assert next(edit.what for edit in editor.edits(2) if "sign" in edit.what) == "the sign of 0.5"
    editor.points.append([0.6, 0.1, 0.87])
    assert next(edit.what for edit in editor.edits(2) if "sign" in edit.what) == "the sign of 0.6"


def test_edits_after_which_a_wrong_value_may_happen_to_be_right_are_marked() -> None:
    editor = Editor(
        "from math import radians\nWHERE = Place(on='table')\nUP = 1\n_ = 2\n"
        "for x in sorted(xs, reverse=True):\n    turn(radians(x) if x >= UP else -x)\n    put(Place(on='island'), x)\n"
    )
    edits = {edit.text.splitlines()[line - 1].strip(): edit for line in (2, 5, 6) for edit in editor.edits(line)}
    for doubtful in (
        "WHERE = Place(on='island')",
        "for x in sorted(xs):",
        "turn(x if x >= UP else -x)",
        "turn(radians(x) if x <= UP else -x)",
    ):
        assert edits[doubtful].chance, doubtful
    assert not edits["turn(radians(x) if x > UP else -x)"].chance
    assert not any("_" in edit for edit in edits)


def test_another_place_of_a_loaded_object_changes_the_scene() -> None:
    def loading(x: float) -> RecordReader:
        record = Mutation()
        record.load_body.body = "milk"
        record.load_body.position.extend([x, 0, 1])
        return cast("RecordReader", SimpleNamespace(records=lambda _: [record]))

    assert (
        changed_place(loading(1.4), loading(-1.4)) == "it changes the scene: milk at [1.4, 0, 1] becomes [-1.4, 0, 1]"
    )
    assert not changed_place(loading(1.4), loading(1.4))


#: It takes the milk up again, after it has placed the milk.
TWICE = """from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import move_arm_joints, pick_up, place

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("table", "environment", "table.urdf")
    world.robot = robot = Object("panda", "robot", "panda.urdf", [0, 0, 0.72])
    robot.set_joint_positions(robot.description.arm("panda").posture("park"))
    milk = Object("milk", "milk", "milk.stl", [0.5, -0.3, 0.82])
    world.settle()
    perform(pick_up(object=milk, arm="panda"))
    perform(place(object=milk, target=[0.5, 0.3, 0.82], arm="panda"))
    perform(pick_up(object=milk, arm="panda"))
    perform(move_arm_joints(arms={"panda": "park"}))
"""


@pytest.mark.slow
def test_an_object_that_is_taken_again_neednt_stay_at_its_target(tmp_path: Path) -> None:
    assert reaches_goal(recorded(tmp_path, TWICE), [])


def test_equal_expressions_change_together_before_one_of_them() -> None:
    edits = {each.text: each for each in Editor("x = f(0, sin(a), b, cos(a))\ny = [p - q, r - s]\n").structural()}
    both, one = "x = f(0, sin(a / 2), b, cos(a / 2))\n", "x = f(0, sin(a / 2), b, cos(a))\n"
    found = {each.text.splitlines(keepends=True)[0]: each for each in edits.values()}
    assert both in found
    assert one not in found  # only the success of the run would support it
    turned = {each.text: each.chance for each in Editor("y = [p - q, r - s]\n").edits(1) if "q - p" in each.text}
    assert turned == {"y = [q - p, r - s]\n": True, "y = [q - p, s - r]\n": True}


def test_what_a_loop_collects_for_later_is_not_made_anew_in_each_iteration() -> None:
    text = "found = []\nfor each in a:\n    go(found, each)\n"
    moved = text.replace("found = []\n", "").replace("    go", "    found = []\n    go")
    assert moved in {each.text for each in Editor(text).edits(1)}
    assert moved + "go(found, 0)\n" not in {each.text for each in Editor(text + "go(found, 0)\n").edits(1)}


def test_unlikely_edits_are_left_out_or_come_late() -> None:
    editor = Editor(
        'kitchen = Object("kitchen", "environment", "k.urdf")\ncup = Object("cup", "cup", "c.stl")\n'
        "for _, x in spots:\n    if x < 2:\n        continue\n    y = 1 if x < 2 else 3\n    put(cup, x, y, [0, 0, 0, 1])\n"
    )
    put = {edit.what for edit in editor.edits(7)}
    assert not {"kitchen instead of cup", "1 times 0.01", "the sign of 1"} & put  # a quaternion has no unit
    assert "[0, 0, 1, 0] instead of [0, 0, 0, 1]" in put
    assert "_" not in editor.plan.unused
    loads = {edit.what for edit in editor.edits(2) if edit.what.startswith("line")}
    assert loads == {"line 2 before line 1"}  # not into the loop
    likely = {edit.line for edit in editor.structural() if edit.what == "x > 2 instead of x < 2"}
    assert likely == {4}  # a loop that skips the wrong items


def test_counts_are_shifted_not_scaled_and_stale_reads_move_first() -> None:
    editor = Editor("spots = [at(i / (n - 1)) for i in range(1, n + 1)]\nx = cup.get_position()\ngo(cup)\n")
    counted = [edit.what for edit in editor.edits(1)]
    assert "range(n) instead of range(1, n + 1)" in counted
    assert not any("times" in each for each in counted)
    likely, unlikely = (min(editor.edits(2, stale=stale)) for stale in (True, False))
    assert (likely.what, likely.cost < unlikely.cost) == ("line 2 after line 3", True)


def test_a_decimal_point_is_suggested_by_an_equal_number_in_spite_of_rounding() -> None:
    edits = {edit.what: edit.chance for edit in Editor("load([0.5, 0.2, 0.83])\nput([0.5, 0.2, 8.3])\n").edits(2)}
    assert not edits["8.3 times 0.1"]  # 8.3 times 0.1 is a little more than 0.83
    assert edits["0.5 times 0.1"]


def test_statements_stay_on_their_side_of_an_assertion() -> None:
    text = "def check(x):\n    assert x\nx = a()\ncheck(x)\nb()\nif x:\n    raise ValueError\nc()\n"
    moves = [edit for line in (3, 5, 8) for edit in Editor(text).edits(line) if edit.what.startswith("line")]
    assert not moves
    plain = Editor(text.replace("check(x)\n", "go(x)\n"))
    assert [edit.what for edit in plain.edits(5) if edit.what.startswith("line")] == [
        "line 5 before line 4",
        "line 5 before line 3",
    ]


def test_what_an_assertion_measures_is_done_before_the_measurement() -> None:
    editor = Editor("a()\ncup.put(1)\noff = cup.get_position()\nb()\nassert off < 1\n")
    moves = {edit.what for line in (2, 4) for edit in editor.edits(line) if edit.what.startswith("line")}
    assert moves == {"line 2 before line 1", "line 4 before line 3", "line 4 before line 2"}


def test_the_scene_and_keys_of_tables_stay_as_they_are() -> None:
    text = 'cup = Object("cup", "cup", "cup.stl", [1, 2, *rest])\nput({"milk": cup, "cereal": "cup"})\nput({"left": 1, "left": 2})\n'
    editor = Editor(text)
    alternatives = [["cup", "milk", "cereal", "floor"], ["left", "right"]]
    loading, keys, twice = ([each.text for each in editor.edits(line, alternatives)] for line in (1, 2, 3))
    assert loading
    assert all('Object("cup", "cup", "cup.stl"' in each for each in loading)
    assert all('{"milk": ' in each and '"cereal": ' in each for each in keys if "put({" in each)
    assert text.replace('{"left"', "{'right'") in twice
