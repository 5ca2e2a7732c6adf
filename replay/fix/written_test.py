"""Write tests from a recording: a test of the whole plan, or of a motion from the moment before it failed."""

from __future__ import annotations

import keyword
import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder import geometry
from recorder.records import Check, Plain, Run
from recorder.tasks import Node
from replay.errors import ReplayError
from replay.report import phrases
from replay.restore.recorded_world import world_state
from replay.state.state import Body, World

if TYPE_CHECKING:
    from pycram.running import RunSpec
    from replay.recording import Recording

_DIGITS: Final = 6  # number of significant digits of poses and joint positions
_ZERO: Final = 1e-6  # joint position in rad or m below which it is left out
_LEVEL: Final = 1e-3  # angle in rad below which a rotation is left out
_WIDTH: Final = 110


def of_plan(log: Recording, spec: RunSpec, file: Path, holds: Sequence[str] = ()) -> str:
    """Return a test that runs the plan, and asserts that the plan succeeds and that properties hold.

    The asserted properties are ``holds``, and those recorded properties that the run violated. A property of a block
    makes the plan itself fail, so the test asserts the plan's success.

    Raises:
        ReplayError: the plan succeeded, and there is no property.
    """
    end = log[-1]
    failed = isinstance(end, Run) and not end.succeeded
    checks = [record for record in log.records(Check) if record.by_run or record.only_record]
    violated = [record.property for record in checks if record.phase == Check.VIOLATED]
    properties = [*dict.fromkeys((*violated, *holds))]
    if not failed and not properties:
        raise ReplayError("the plan succeeded; say what should have held: --holds 'always milk.z > 0.5'")
    plan = os.path.relpath(spec.plan, file.absolute().parent)
    given = {"seed": spec.seed, "motion": spec.motion or None, "arguments": spec.arguments or None, **spec.parameters}
    words = [repr(plan), *(f"{name}={value!r}" for name, value in given.items() if value is not None)]
    what = phrases.failure(end.failure) if isinstance(end, Run) and failed else f"violates {properties[0]}"
    head, body = f"def test_{_name(spec.plan.stem)}(run_plan):", [f"run = run_plan({', '.join(words)})"]
    body += ["assert run.succeeded, run.output"] if failed and not violated else []
    return _text(f"{spec.plan.name}: {what}", log, [], head, body, "run", properties)


def of_moment(log: Recording, task: Node, holds: Sequence[str] = ()) -> str:
    """Return a test that rebuilds the world before a motion or action, performs it, and asserts properties.

    Raises:
        ReplayError: the task isn't a motion or action, or its world can't be rebuilt.
    """
    if task.kind not in ("motion", "action"):
        raise ReplayError(f"{phrases.node(task)} is no motion or action; give the step of a motion or action")
    world = world_state(log, task.started.seq - 1, task.started.world or None)
    names = {body: _variable(body) for body in world.bodies}
    function = task.name.replace("-", "_")
    arguments = ", ".join(f"{name}={value}" for name, value in _arguments(task, names).items())
    imports = ["from pycram import perform", "from pycram.bullet_world import BulletWorld, Object"]
    imports.append(f"from pycram.{task.kind}_designators import {function}")
    head = f"def test_{function}(pycram_world, pycram_record):"
    body = [*_scene(world, names), f"perform({function}({arguments}))"]
    what = f"{phrases.node(task)}, step {task.last_step}: {phrases.error(task)}"
    return _text(what, log, imports, head, body, "pycram_record", holds)


def _text(
    what: str, log: Recording, imports: list[str], head: str, body: list[str], run: str, holds: Sequence[str]
) -> str:
    shown = phrases.one_line(what).replace("\\", "\\\\").replace('"', "'")
    title = f'"""{shown}\n\nWritten by pycram-replay test {log.path.name}. It passes when the failure is repaired.\n"""'
    imports = [*imports, *(["from replay.testing import assert_holds"] if holds else [])]
    body = [*body, *(f"assert_holds({run}, {text!r})" for text in holds)]
    lines = [textwrap.fill(_without_unused_name(line, body), _WIDTH, break_long_words=False) for line in body]
    inner = textwrap.indent("\n".join(lines), "    ")
    return "\n".join((title, "", *imports, *(["", ""] if imports else [""]), head, inner, ""))


def _without_unused_name(line: str, body: Sequence[str]) -> str:
    """Return a statement; its variable is left out if no other statement uses it."""
    name, _, call = line.partition(" = ")
    used = any(re.search(rf"\b{name}\b(?!['\"])", other) for other in body if other != line)
    return call if call and name.isidentifier() and not used else line


def _scene(world: World, names: dict[str, str]) -> Iterator[str]:
    """Yield statements that build a world's state."""
    if any(world.gravity):
        yield f"pycram_world.set_gravity({_vector(world.gravity)})"
    for body in world.bodies.values():
        yield from _body(body, names[body.name])
    if world.robot:
        yield f"BulletWorld.robot = {names[world.robot]}"
    for held in world.attachments.values():
        links = [f"link={held.carrier_link!r}"] if held.carrier_link else []
        links += [f"other_link={held.body_link!r}"] if held.body_link else []
        yield f"{names[held.carrier]}.attach({', '.join((names[held.body], *links))})"


def _body(body: Body, name: str) -> Iterator[str]:
    loaded = body.loaded
    if not loaded.path:
        raise ReplayError(f"{body.name}: the recording doesn't name its model's file, so the scene can't be written")
    where = [_vector(body.position)]
    if geometry.angle(body.orientation, geometry.IDENTITY[1]) > _LEVEL:
        where.append(_vector(body.orientation))
    where += [f"scale={loaded.scale!r}"] if loaded.scale not in (0, 1) else []
    where += [f"color={_vector(body.color)}"] if body.color else []
    yield f"{name} = Object({', '.join((*map(repr, (body.name, body.type, loaded.path)), *where))})"
    joints = [f"{joint!r}: {_number(value)}" for joint, value in body.joints.items() if abs(value) > _ZERO]
    if joints:
        yield f"{name}.set_joint_positions({{{', '.join(joints)}}})"


def _arguments(task: Node, names: dict[str, str]) -> dict[str, str]:
    """Return the task's arguments as Python code; if there is an argument for each arm, they become a mapping."""
    found: dict[str, str] = {}
    arms: dict[str, Plain] = {}
    for slot, value in task.parameters.items():
        if slot.endswith("-arm"):
            arms[slot.removesuffix("-arm")] = value
        elif isinstance(value, dict) and str(value.get("object")) not in names:
            raise ReplayError(f"{phrases.value(value)} can't be written as an argument of a test")
        else:
            found[_variable(slot)] = names[str(value["object"])] if isinstance(value, dict) else repr(value)
    return found | ({"arms": repr(arms)} if arms else {})


def _vector(values: Sequence[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return f"{value + 0.0:.{_DIGITS}g}"


def _name(text: str) -> str:
    return re.sub(r"\W+", "_", text).strip("_").lower() or "plan"


def _variable(text: str) -> str:
    name = _name(text)
    return f"{name}_" if keyword.iskeyword(name) else f"_{name}" if name[0].isdigit() else name
