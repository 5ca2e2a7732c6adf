"""The command ``pycram describe``: print a guessed description of a robot or of furniture, or check a description."""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence, Sized
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.describing.check import always_touching, check, parked
from pycram.describing.grippers import SuctionGuess
from pycram.describing.guess import as_toml, guess, quoted
from pycram.foundation.failures import AssetError
from pycram.models import canonical_urdf, files, load
from pycram.models.corrections import SUFFIX
from pycram.models.files import ROBOT_URDFS, find, mount_gripper, parse_toml, read_bytes, with_absolute_meshes
from pycram.models.furniture import find_furniture, furniture_of
from pycram.models.load import Model
from pycram.models.robots.description import RobotDescription
from pycram.models.surfaces import DOOR, DRAWER, Surface, closed_position
from pycram.vision import Camera, drawable
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Vector
from recorder.packages import needed
from recorder.urdf import Urdf

if TYPE_CHECKING:
    import argparse


with needed():
    from PIL import Image, ImageDraw

_SIZE: Final = (800, 600)  # pixels
_AWAY: Final = (1.0, 0.7, 0.45)  # direction from the robot to the viewpoint
_ABOVE: Final = (-0.45, -0.5, 1.0)  # direction from furniture to the camera, which sees over walls and sees the doors
_MARGIN: Final = 1.1  # distance of the camera, as a multiple of the distance at which the robot just fills the picture
_OVERSAMPLING: Final = 2
_FIELD: Final = math.tan(math.radians(25))  # tangent of half the horizontal field of view
_AXIS: Final = 0.12  # length in m of a tool frame's axes
_COLORS: Final = ("#e03030", "#30a030", "#3060e0")  # x, y, z
_OPEN: Final = (48, 160, 48)  # RGB of surfaces outside containers
_INSIDE: Final = {DRAWER: (230, 120, 20), DOOR: (48, 96, 224)}  # RGB of surfaces in containers
_FILLED: Final = 110  # opacity of surfaces, 0 to 255


def draw(body: Object, file: Path) -> None:
    """Draw a robot or furniture into a picture file; the suffix of the file determines the format.

    Surfaces are drawn over the parts that hide them: green, or in drawers orange, or behind doors blue. AssetError is
    raised if the file can't be written, or if no image format has the suffix.
    """
    low, high = (np.array(corner) for corner in body.get_AABB())
    surfaces = {
        surface: [geometry.transform(body.surface_pose(surface), (x, y, 0.0)) for x, y in surface.outline]
        for surface in body.surfaces.values()
    }
    if surfaces:  # the walls of a kitchen are left out
        corners = np.array([*itertools.chain(*surfaces.values())])
        low[:2], high[:2] = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
        high[2] = corners[:, 2].max()
    arms = body.description.arms.values() if body.description else ()
    poses = [arm.tool_pose(body.get_link_position_and_orientation(arm.tool_frame)) for arm in arms]
    tools = [[pose[0], *(geometry.transform(pose, end) for end in (_AXIS * np.eye(3)).tolist())] for pose in poses]
    points = np.vstack([*itertools.product(*zip(low, high, strict=True)), *itertools.chain(*tools)])
    middle, away = (low + high) / 2, _AWAY if body.is_robot else _ABOVE  # the camera sees all points
    height = _FIELD * _SIZE[1] / _SIZE[0]
    turn = geometry.look_at(away, (0.0, 0.0, 0.0))
    right, down, ahead = ((points - middle) @ geometry.to_matrix(turn)).T
    distance = _MARGIN * float(np.maximum(np.abs(right) / _FIELD - ahead, np.abs(down) / height - ahead).max())
    x, y, z = (middle + distance * np.array(away) / math.hypot(*away)).tolist()
    camera = Camera(((x, y, z), turn), _FIELD, height)
    pixels = (_SIZE[0] * _OVERSAMPLING, _SIZE[1] * _OVERSAMPLING)
    with body.world.lock:
        sight = camera.draw([drawable(body)], camera.window, pixels)
    image = Image.fromarray(sight.picture(camera.up)).resize(_SIZE, Image.Resampling.BOX)
    pen = ImageDraw.Draw(image, "RGBA")
    for surface, outline in surfaces.items():
        color = _INSIDE[body.container(surface.container).kind] if surface.container else _OPEN
        pen.polygon([(x, y) for x, y in _flat(camera, outline)], fill=(*color, _FILLED), outline=color)
    for tool in tools:
        origin, *ends = _flat(camera, tool)
        for end, axis in zip(ends, _COLORS, strict=True):
            pen.line([*origin, *end], fill=axis, width=3)
    try:
        image.save(file)
    except (OSError, ValueError) as error:  # ValueError: no image format has the suffix
        raise AssetError(file, str(error)) from error
    print(f"picture in {file}", file=sys.stderr)


def _flat(camera: Camera, points: Sequence[Vector]) -> list[list[float]]:
    """Return the pixels of points in the world."""
    seen = camera.to_frame(np.array(points))
    flat: list[list[float]] = ((seen[:, :2] / seen[:, 2:] / [camera.right, camera.down] + 1) / 2 * _SIZE).tolist()
    return flat


_FINE, _FAILED, _WRONG_USAGE = 0, 1, 2  # exit codes
_IN_A_ROW: Final = 2  # maximum number of successive movable joints of furniture, as for a drawer behind a door


def run(options: argparse.Namespace) -> int:
    """Run the command; return its exit code: 0 for success, 1 if a check failed, 2 for wrong usage."""
    if options.file is None and options.check is None:
        return _refused("give a URDF, or --check with a description")
    try:
        if options.check:
            return _check(RobotDescription.load(options.check), options)
        if options.gripper == "two-finger":
            options.file = _with_grippers(options.file)
        model = load.load(options.file)
        if is_furniture(model):
            print(describe_furniture(model, options.file), end="")
            description = None
        else:
            text = describe_robot(options.file, suction=options.gripper == "suction")
            description = RobotDescription.parse(text, "the first description")
            print(text, end="")
        if options.picture:
            with BulletWorld() as world:
                if description is not None:
                    body = _loaded(description, options.file, world)
                else:
                    body = Object(model.urdf.name or "furniture", "environment", options.file, world=world)
                draw(body, options.picture)
    except AssetError as error:
        return _refused(str(error))
    return _FINE


def _check(description: RobotDescription, options: argparse.Namespace) -> int:
    robot_name = description.robot.removesuffix("_with_gripper")
    urdf = options.file or next((name for name in ROBOT_URDFS if Path(name).stem == robot_name), None)
    if urdf is None:
        return _refused(
            f"{options.check} describes {description.robot}, which isn't bundled: give the robot's URDF, too"
        )
    with BulletWorld() as world:
        robot = _loaded(description, urdf, world)
        failed = 0
        for finding in check(robot, description):
            print(finding)
            failed += not finding.passed
        if options.picture:
            draw(robot, options.picture)
    print(f"{failed} of the checks failed" if failed else "all checks passed", file=sys.stderr)
    return _FAILED if failed else _FINE


def _loaded(description: RobotDescription, urdf: str, world: BulletWorld) -> Object:
    """Load a robot with parked arms above the ground, where it touches nothing."""
    robot = Object(description.robot, "robot", urdf, [0.0, 0.0, 1.0], world=world, description=description)
    for arm in description.arms.values():
        if "park" in arm.poses:
            robot.set_joint_positions(arm.posture("park"))
    return robot


def _with_grippers(urdf: str) -> str:
    """Write a URDF of a robot with PyCRAM's gripper on each arm that has no gripper; return the file's name."""
    source = find(urdf)
    arms = [(arm, hand) for arm, hand in guess(load.load(urdf), suction=True).arms if not arm.fingers]
    if not arms:
        raise AssetError(urdf, "all arms have a gripper")
    robot = canonical_urdf.read(source, files.expanded(source, read_bytes(source)))
    robot.set("name", f"{robot.get('name')}_with_gripper")
    for arm, hand in arms:
        assert isinstance(hand, SuctionGuess)  # noqa: S101  arms without grippers get suction cups
        xyz, rpy = (" ".join(map(repr, numbers)) for numbers in (hand.offset[0], geometry.to_rpy(hand.offset[1])))
        mount_gripper(robot, arm.joints[-1].child, xyz, rpy, f"{arm.name}_" if len(arms) > 1 else "")
    target = Path(f"{source.name.partition('.')[0]}_with_gripper.urdf")
    try:
        with target.open("xb") as file:
            file.write(with_absolute_meshes(robot, source))
    except OSError as error:
        raise AssetError(target, f"the file can't be written: {error.strerror}") from error
    print(f"the robot with grippers is in {target}; load this file", file=sys.stderr)
    return str(target)


def _refused(reason: str) -> int:
    print(f"pycram describe: {reason}", file=sys.stderr)
    return _WRONG_USAGE


def describe_robot(urdf: str | Path, *, suction: bool = False) -> str:
    """Return a guessed description of a robot as TOML; raise an AssetError if the URDF can't be loaded.

    With ``suction``, arms without a recognised gripper get a suction cup at the end of their last link.
    """
    model = load.load(urdf)
    found = guess(model, suction=suction)
    draft = RobotDescription.parse(as_toml(found), "the first description")
    with BulletWorld() as world:
        robot = Object("robot", "robot", urdf, description=draft, model=model)
        arms = [draft.arm(chain.name) for chain, _ in found.arms]
        with world.lock:
            touching = set().union(*(always_touching(robot, arm) for arm in arms))
        robot.remove()
        tolerant = RobotDescription.parse(as_toml(found, may_touch=touching), "the first description")
        robot = Object("robot", "robot", urdf, description=tolerant, model=model)
        park: dict[str, list[float]] = {}
        with world.lock:
            for arm in arms:
                park[arm.name] = parked(robot, arm)
                robot.set_joint_positions(dict(zip(arm.joints, park[arm.name], strict=True)))
    return as_toml(found, park, touching)


def is_furniture(model: Model) -> bool:
    """Return whether a model is furniture: it has surfaces, but no arms, legs or wheels."""
    found, tree = guess(model), model.urdf
    in_a_row = max(sum(joint.movable for joint in tree.chain(tree.root, link)) for link in tree.links)
    return not (bool(found.arms) or in_a_row > _IN_A_ROW) and not found.drives and bool(furniture_of(model).surfaces)


def describe_furniture(model: Model, urdf: str | Path) -> str:
    """Return the TOML of found furniture with its corrections; raise AssetError for corrections of other furniture."""
    tree = model.urdf
    found, now = find_furniture(model.path, tree), furniture_of(model)
    beside = next((file for file in model.files if file.name.endswith(SUFFIX)), None)
    said: Any = parse_toml(beside.content.decode(), beside.name) if beside else {}
    surfaces = {name: _of_surface(surface, tree) for name, surface in now.surfaces.items()}
    containers = {
        name: f"{each.kind}, {tree.joints[each.joint].type} {each.joint} {each.closed:g} to {each.open:.4g}, "
        f"{f'handle {each.handle}' if each.handle else 'no handle'}"
        for name, each in now.containers.items()
    }
    opening = {container.joint for container in now.containers.values()}
    others = [f"{joint} ({tree.joints[joint].type})" for joint in tree.movable if joint not in opening]
    file = f"{Path(urdf).stem}{SUFFIX}"
    lines = [
        f"# {tree.name}: {_count(surfaces, 'surface')}, {_count(containers, 'container')}; written by pycram describe.",
        f"# To rename or correct entries, save this text next to the URDF as {file}. Units: metres, radians.",
        *_tables("surfaces", [*found.surfaces], said.get("surfaces", {}), surfaces),
        *_tables("containers", [*found.containers], said.get("containers", {}), containers),
    ]
    if others:
        lines += ["", "# Joints that open nothing:", *(f"#   {joint}" for joint in others)]
    return "\n".join(lines) + "\n"


def _count(things: Sized, name: str) -> str:
    return f"{len(things) or 'no'} {name}{'' if len(things) == 1 else 's'}"


def _tables(kind: str, found: list[str], said: Mapping[str, Any], now: Mapping[str, str]) -> Iterator[str]:
    """Yield a table for each surface or container, with its corrections; a comment describes the thing."""
    for key in dict.fromkeys([*found, *said]):
        entries = said.get(key, {})
        yield from ("", f"[{kind}.{quoted(key)}]  # {now.get(entries.get('name', key), 'removed')}")
        for entry, value in entries.items():  # JSON values are TOML values, except infinity
            yield f"{entry} = {'inf' if value == math.inf else json.dumps(value, ensure_ascii=False)}"


def _of_surface(surface: Surface, tree: Urdf) -> str:
    closed = {name: closed_position(tree.joints[name]) for name in tree.movable}
    height = geometry.transform(tree.forward_kinematics(closed, surface.link), surface.position)[2]
    x, y = surface.size
    above = "open above" if surface.clearance == math.inf else f"{surface.clearance:.2f} free above"
    inside = f", in {quoted(surface.container)}" if surface.container else ""
    return f"{x:.2f} x {y:.2f} at height {height:.3f}, {above}, on {surface.link}{inside}"
