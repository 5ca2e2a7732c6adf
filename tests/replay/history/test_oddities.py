"""Lines that look like a slip, by the source alone; the corrected source has none."""

from __future__ import annotations

import pytest

from replay.history.flow import Flow
from replay.history.oddities import is_strong, oddities

CASES = [
    ("rows = [[0, 1]] * 3\nprint(rows)", "rows = [[0, 1] for _ in range(3)]\nprint(rows)", 1, "one and the same"),
    ("def f(a, used=[]):\n    used.append(a)\nf(1)", "def f(a, used=()):\n    return a, used\nf(1)", 1, "default of used"),
    ("def f(goal):\n    for goal in (1, 2):\n        g(goal)\nf(3)", "def f(goal):\n    for each in (1, 2):\n        g(each, goal)\nf(3)", 2, "parameter goal"),
    ("def f(x, y):\n    return x\nx, y = 1, 2\nf(y, x)", "def f(x, y):\n    return x\nx, y = 1, 2\nf(x, y)", 4, "parameters are x, y"),
    ("for i in range(1, len(a)):\n    g(a[i])", "for i in range(1, len(a)):\n    g(a[i] - a[i - 1])", 1, "begins at 1"),
    ("for i in range(len(a) - 1):\n    g(a[i])", "for i in range(len(a)):\n    g(a[i])", 1, "leaves out"),
    ("if x > 1:\n    f()\nelif x > 5:\n    g()", "if x > 5:\n    f()\nelif x > 1:\n    g()", 2, "all cases of line 3"),
    ("A = {'a': 1, 'b': 2}\nB = ('a',)\nif x in A:\n    f()\nelif x in B:\n    g()", "A = {'a': 1, 'b': 2}\nB = ('a',)\nif x in B:\n    f()\nelif x in A:\n    g()", 4, "all cases of line 5"),
    ("try:\n    f()\nexcept E:\n    pass", "try:\n    f()\nexcept E:\n    g()", 4, "ignored"),
    ("for x in a:\n    f(x)\n    break", "for x in a:\n    if f(x):\n        break", 3, "first iteration"),
    ("for x in a:\n    try:\n        f(x)\n    except E:\n        pass\n    break", "for x in a:\n    try:\n        f(x)\n    except E:\n        continue\n    break", 6, "ends the loop in its first"),
    ("for x in a:\n    try:\n        y = x\n        f(x)\n    except E:\n        g()\nh(y)", "for x in a:\n    try:\n        y = x\n        f(x)\n        break\n    except E:\n        g()\nh(y)", 4, "after a success"),
    ("y = 0\nfor row in a:\n    for b in row:\n        f(y)\n        y += 1", "for row in a:\n    y = 0\n    for b in row:\n        f(y)\n        y += 1", 1, "isn't set again"),
    ("for x in a:\n    f.append(lambda: g(x))", "for x in a:\n    f.append(lambda x=x: g(x))", 2, "as the loop left it"),
    ("class A:\n    def look(self):\n        self.seen = read()\na = A()\nf(a.seen)", "class A:\n    def look(self):\n        self.seen = read()\na = A()\na.look()\nf(a.seen)", 5, "never called"),
    ("a, b = f()\ng(a)\ng(a)\nassert b", "a, b = f()\ng(a)\ng(b)\nassert b", 3, "b isn't used"),
    ("def middle(a, b):\n    return a + b / 2\nmiddle(1, 2)", "def middle(a, b):\n    return (a + b) / 2\nmiddle(1, 2)", 2, "only b"),
    ("def f(degrees):\n    return sin(degrees / 2)\nf(1)", "def f(degrees):\n    return sin(radians(degrees) / 2)\nf(1)", 2, "degrees"),
    ("q = [cos(a / 2), 0, 0, sin(a / 2)]\nf(q)", "q = [0, 0, sin(a / 2), cos(a / 2)]\nf(q)", 1, "w comes first"),
    ("world.settle()\nworld.set_gravity(G)", "world.set_gravity(G)\nworld.settle()", 1, "before line 2"),
    ("x, y, z = a.get_position()\ncarry(a)\ncarry(b, x)", "carry(a)\nx, y, z = a.get_position()\ncarry(b, x)", 1, "before line 2"),
    ("for x in a:\n    a.remove(x)", "for x in [*a]:\n    a.remove(x)", 1, "while it iterates"),
    ("rows = [[0] * 2] * 3\nprint(rows)", "rows = [[0] * 2 for _ in range(3)]\nprint(rows)", 1, "items are one"),
    ("a = dict.fromkeys(b, [])\nf(a)", "a = dict.fromkeys(b, 0)\nf(a)", 1, "all keys share"),
    ("a = b.rstrip('_cup')\nf(a)", "a = b.removesuffix('_cup').rstrip('0')\nf(a)", 1, "not the text '_cup'"),
    ("for a in groupby(b, key=c):\n    f(a)", "for a in groupby(sorted(b, key=c), key=c):\n    f(a)", 1, "only neighbours"),
    ("f(atan2(dx, dy))", "f(atan2(dy, dx))", 1, "takes y first"),
    ("f(atan2(a[0] - b[0], a[1] - b[1]))", "f(atan2(a[1] - b[1], a[0] - b[0]))", 1, "takes y first"),
    ("def f(a):\n    return (x for x in a)\nb = f(1)\nif 1 in b:\n    g(b)", "def f(a):\n    return [x for x in a]\nb = f(1)\nif 1 in b:\n    g(b)", 2, "b is used up"),
    ("def f(a):\n    return perform(a)\ng(all(f(x) for x in a))", "def f(a):\n    return perform(a)\ng(all([f(x) for x in a]), b.any())", 3, "leaves the others out"),
    ("@cache\ndef f(a):\n    return a.get_position()\ng(f(1))", "@cache\ndef f(a):\n    return a.get_AABB()\ng(f(1))", 1, "keeps its first answer"),
    ("class A:\n    def f(self):\n        self.b = 0\n        b = 1\n        g(self.b)\nh(A().f())", "class A:\n    def f(self):\n        self.b = 0\n        b = 1\n        g(self.b, b)\nh(A().f())", 4, "not self.b"),
    ("with par:\n    perform(a)\n    b = c.get_position()\nf(b)", "with par:\n    perform(a)\nb = c.get_position()\nf(b)", 3, "before the motions"),
    ("f([0, 0, sin(a), cos(a)])", "half = a / 2\nf([0, 0, sin(half), cos(half)], [0, 0, sin(pi / 4), cos(pi / 4)])", 1, "half of the angle"),
    ("b = a.sort()\nf(b)", "b = sorted(a)\nf(b)", 1, "returns None"),
]  # fmt: skip


@pytest.mark.parametrize(("wrong", "right", "line", "words"), CASES, ids=[each[3] for each in CASES])
def test_a_slip_is_found_and_its_correction_is_not(wrong: str, right: str, line: int, words: str) -> None:
    found = oddities(wrong)
    assert words in found[line]
    assert is_strong(found[line])
    assert not any(map(is_strong, oddities(right).values()))


def test_a_slip_comes_before_the_lines_that_a_failed_line_reads() -> None:
    text = "y = 0\nSTEP = 0.4\nfor row in a:\n    for b in row:\n        f(y, STEP)\n        y += STEP\n"
    assert Flow(text).lines({5: 0.0}, failed=5)[0] == 1
    assert Flow(text.replace("y += STEP", "y = STEP")).lines({5: 0.0}, failed=5)[0] == 5


def test_names_that_a_plan_does_not_use_are_no_likely_slips() -> None:
    assert not is_strong(oddities("A = 1\nf()")[1])
    assert not oddities("def f():\n    return 1\n")  # other files call the functions of a module
