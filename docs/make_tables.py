"""Write the tables of objects.md and bundled.md: ``python -m docs.make_tables docs/reference``.

The pages contain signatures, docstrings, models and computed grasps, so they are always correct.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import trimesh

from pycram.bullet_world import BulletWorld, Object
from pycram.models import files, load
from pycram.models.furniture import furniture_of
from pycram.reasoning.grasping.grasps import FREE, candidates
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from pycram.models.surfaces import Surface
    from recorder.urdf import Urdf

_OBJECTS: Final = """\
# BulletWorld and Object: all names

`from pycram.bullet_world import BulletWorld, Object`. `make reference` writes this page from the signatures and
docstrings of both classes. Positions are [x, y, z] in m in the world frame, and orientations are quaternions
[x, y, z, w]. Joint positions are in rad or m. Attributes are read-only, except `robot`; methods change them.

The web site also has a [page with all parameters and errors](names/worlds.md). This page exists only in the web site.
"""
_WORLD: Final = """\
`world.robot = pr2`, or `BulletWorld.robot = pr2`, sets the robot that plans control. `BulletWorld.current_bullet_world`
is the current world. `with BulletWorld() as world:` closes the world at the end of the block.
"""
#: Attributes that a constructor sets, with their meanings.
ATTRIBUTES: Final = {
    Object: {
        "name": "Name, unique in the world.",
        "type": 'Type, such as "milk", "robot" or "environment".',
        "world": "The world of the object.",
        "color": "RGBA 0..1; None for the colours of the model.",
        "description": "Description of a robot, with `arm(name)`; None for other objects.",
        "original_pose": "Position and orientation at loading.",
        "overlaps": "Objects that the object overlapped at loading; the warning `Overlapping` names them.",
    },
    BulletWorld: {
        "name": "Name of the world in records.",
        "mode": '"DIRECT", or "GUI" for a world with a window.',
        "gravity": "Gravity [x, y, z] in m/s^2; (0, 0, 0) until `set_gravity` is called.",
        "sim_step": "Number of simulated steps of 1/240 s.",
        "robots": "All robots, in the order in which they were loaded.",
        "closed": "Whether the world has ended.",
    },
}
#: Methods that only PyCRAM itself calls.
_INTERNAL: Final = frozenset(
    ["add", "handle", "load_record", "check_link", "check_joint", "prepare_time_listeners", "record_keyframe", "lock"]
)
_BUNDLED: Final = """\
# Bundled kitchen and objects: sizes and places

`make reference` writes this page from the bundled models. Lengths are in m, in the frame of the model; if a model is
loaded without a position, this frame is the world frame. The [guide to models](../guides/models.md#bundled-models)
lists all bundled models.

## Surfaces

`Object("kitchen", "environment", "kitchen.urdf")` has the following surfaces; drawers and doors are closed. Each name
is a destination of an action, as in `transporting(object=milk, target="counter")`. x and y are the ranges of the
surface. The position of an object is its middle, so a standing object is half its height above the surface: the milk
on the counter is at z = {counter} + {half}. The [tutorial](../tutorial/2_a_plan_of_motions.md) shows where the PR2
stands when it works at the counter. A [property](properties.md) names the link of a surface, as in
`on(milk, kitchen.kitchen_island_surface)`. The last row is the surface of another model, `table.urdf`.
"""
_CONTAINERS: Final = """\
## Drawers and doors

`perform(opening(container="fridge"))` opens a container. `kitchen.get_joint_position(joint)` returns how far the
container is open: in m for a drawer, and in rad for a door. All containers are closed at 0. The link of a handle is
`kitchen.container("fridge").handle`.
"""
_GRASPS: Final = """\
## Objects and grippers

A two-finger gripper can hold an object along a horizontal axis on which the object is at least {free} mm narrower
than the opening. The last four columns list the sides from which a hand can grasp the upright object; the PR2 and
TIAGo Pro use the left hand. The robot looks along the object's x axis. `rim` is a grasp from the top over the rim. The
columns ignore other objects and the reach of the arm. Sizes are in mm.
"""
_ROBOTS: Final = {"pr2": "PR2", "tiago_pro": "TIAGo Pro", "panda": "Panda", "ur5": "UR5"}


def objects() -> str:
    """Return the page of the methods and attributes of worlds and objects, as Markdown."""
    parts = [_OBJECTS]
    for kind in (Object, BulletWorld):
        rows = {f"`{name}`": meaning for name, meaning in ATTRIBUTES[kind].items()}
        methods = {}
        for name, member in vars(kind).items():
            if name.startswith("_") or name in _INTERNAL:
                continue
            text = _first_paragraph(inspect.getdoc(member) or "")
            if inspect.isroutine(inspect.unwrap(member)) or isinstance(member, staticmethod):
                methods[f"`{name}{_arguments(getattr(kind, name))}`"] = text
            elif isinstance(member, property):
                rows[f"`{name}`"] = text
        parts += [f"## {kind.__name__}\n", *([_WORLD] if kind is BulletWorld else [])]
        parts += [_table(("attribute", "meaning"), rows.items())]
        parts.append(_table(("method", "what it does"), methods.items()))
    return "\n".join(parts)


def _arguments(function: Callable[..., object]) -> str:
    parameters = inspect.signature(function).parameters.values()
    plain = [each.replace(annotation=each.empty) for each in parameters if each.name != "self"]
    return str(inspect.Signature(plain))


def _first_paragraph(text: str) -> str:
    text = re.sub(r" \(:(?:class|mod):`[^`]*`\)", "", text.partition("\n\n")[0])
    text = re.sub(r":meth:`(\w+)`", r"`\1`", text)
    return text.replace("``", "`").replace("\n", " ").replace("|", "\\|")


def bundled() -> str:
    """Return the page of the sizes and places of bundled models, as Markdown."""
    (counter,) = (row[3] for row in _surfaces() if row[0] == "counter")
    intro = _BUNDLED.format(counter=counter, half=f"{float(sizes()['milk'][2]) / 2000:.3f}")
    grippers = _GRASPS.format(free=f"{1000 * FREE:g}")
    return f"{intro}\n{surfaces()}\n{_CONTAINERS}\n{containers()}\n{grippers}\n{grasps()}"


def surfaces() -> str:
    """Return the table of the surfaces of the bundled furniture."""
    return _table(("surface", "x", "y", "height", "free above", "in", "link"), _surfaces())


def _surfaces() -> list[tuple[str, ...]]:
    """Return the rows of the table of surfaces."""
    rows = []
    for name in ("kitchen.urdf", "table.urdf"):
        model = load.load(name)
        for surface in furniture_of(model).surfaces.values():
            found = (surface.name, *_extents(model.urdf, surface), _free(surface.clearance))
            found = (*found, surface.container, f"`{surface.link}`")
            rows.append((found, name, bool(surface.container)))
    rows.sort(key=lambda row: row[1:])
    return [row for row, *_ in rows]


def containers() -> str:
    """Return the table of the drawers and doors of the kitchen."""
    found = furniture_of(load.load("kitchen.urdf")).containers.values()
    rows = [(each.name, each.kind, f"`{each.joint}`", f"{each.open:.2f}") for each in found]
    return _table(("container", "kind", "joint", "open at"), rows)


def _extents(urdf: Urdf, surface: Surface) -> Iterator[str]:
    """Yield the ranges of x and y of a surface, and its height, with closed containers."""
    pose = geometry.multiply(urdf.forward_kinematics({}, surface.link), surface.pose)
    corners = [geometry.transform(pose, (x, y, 0.0)) for x, y in surface.outline]
    for values in list(zip(*corners, strict=True))[:2]:
        yield f"{_rounded(min(values))} to {_rounded(max(values))}"
    yield _rounded(pose[0][2])


def _rounded(length: float) -> str:
    return f"{length + 1e-9:.3f}"  # the same text on all machines for a length such as 0.1045


def _free(clearance: float) -> str:
    return "open" if math.isinf(clearance) else f"{clearance + 1e-9:.2f}"


def sizes() -> dict[str, tuple[str, str, str]]:
    """Return the lengths of the bundled objects in x, y and z, in mm."""
    found = {}
    for file in sorted(files.resources().glob("*.stl")):
        low, high = trimesh.load_mesh(file).bounds * 1000
        x, y, z = (f"{length:.0f}" for length in high - low)
        found[file.stem] = x, y, z
    return found


def grasps() -> str:
    """Return the table of the sizes of the bundled objects, and of the sides from which the robots' grippers fit."""
    rows = [[name, *size] for name, size in sizes().items()]
    columns = ["object", "x", "y", "z"]
    with BulletWorld() as world:
        things = [Object(row[0], "thing", f"{row[0]}.stl", [5 + i, 0, 1]) for i, row in enumerate(rows)]
        for number, (name, title) in enumerate(_ROBOTS.items()):
            world.robot = robot = Object(name, "robot", f"{name}.urdf", [0, 3 * number, 0])
            arm = next(iter(robot.description.arms.values()))
            columns.append(f"{title}: opens to {1000 * arm.gripper.aperture:.0f}")
            for row, thing in zip(rows, things, strict=True):
                sides = ["rim" if each.label.startswith("rim") else each.name for each in candidates(thing, robot, arm)]
                row.append(", ".join(dict.fromkeys(sides)))
            world.remove(robot)
    return _table(columns, rows)


def _table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [tuple(columns)]
    lines += [("---",) * len(lines[0]), *map(tuple, rows)]
    return "\n".join(["|".join(["", *(f" {cell} " for cell in line), ""]) for line in lines]) + "\n"


PAGES: Final = {"objects.md": objects, "bundled.md": bundled}
"""Functions that return pages, by the pages' files in ``docs/reference``."""


def main(folder: str) -> None:
    """Write the pages into a folder."""
    for name, page in PAGES.items():
        Path(folder, name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
