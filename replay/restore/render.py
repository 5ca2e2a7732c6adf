"""Pictures of any step, without a viewer: the world is rebuilt aside and seen by the software renderer.

From a camera of the robot, as it was directed; from a point to a point; or, if nothing is said, from where the things
that the plan is about are seen well.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.vision.camera import Camera
from recorder import geometry
from recorder.extras import needed
from replay.errors import NoSuchName, ReplayError
from replay.restore.world import unrecorded

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from recorder.geometry import Vector
    from replay.file.log import Log

with needed():
    from PIL import Image

_WIDE: Final = math.radians(60)  # horizontal field of view where no camera says another
_NEAR, _FAR = 0.02, 30.0  # m
_SIDE: Final = (-0.55, -0.65, 0.55)  # the direction to look from, of the robot's heading
_FINER: Final = 2  # pixels a side that are averaged to one: edges are smooth then
_LARGEST: Final = 4096  # pixels a side


def render(
    log: Log,
    step: int | str,
    *,
    camera: str | None = None,
    eye: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    size: tuple[int, int] = (640, 480),
    world: str | None = None,
) -> Image.Image:
    """A picture of a world as it was after a step.

    Args:
        log: the recording.
        step: a number, or a name as :func:`replay.explain.step_names.step_of` knows them.
        camera: a frame of the robot, as "wide_stereo_optical_frame"; its own field of view if it is the robot's camera.
        eye: where to look from, xyz in m; by default from the side.
        target: where to look, xyz in m; by default the middle of robot and movable things.
        size: width and height in pixels.
        world: its name; without one, the open one that was opened last.

    Raises:
        NotRestored: none was open then.
        NoSuchName: there is no such frame.
        ReplayError: a size or a point that can't be.
    """
    with unrecorded(log, step, world) as restored:
        return seen(restored, camera=camera, eye=eye, target=target, size=size)


def seen(
    world: BulletWorld,
    *,
    camera: str | None = None,
    eye: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
    size: tuple[int, int] = (640, 480),
) -> Image.Image:
    """A picture of a live world.

    Args:
        world: the world.
        camera: as for :func:`render`, as are the others.
        eye: where to look from.
        target: where to look.
        size: width and height in pixels.

    Raises:
        NoSuchName: there is no such frame.
        ReplayError: a size or a point that can't be.
    """
    if not all(isinstance(side, int) and 0 < side <= _LARGEST for side in size):
        raise ReplayError(f"a picture can't have {size[0]} x {size[1]} pixels; take 1 to {_LARGEST} a side")
    if camera is not None:
        return _picture(world, _of_robot(world, camera, size), size)
    aim = _middle(world) if target is None else _point("target", target)
    place = _beside(world, aim) if eye is None else _point("eye", eye)
    if math.dist(place, aim) < 1e-6:
        raise ReplayError(f"a picture from {list(place)} to the same point has no direction")
    return _picture(world, _camera(place, geometry.look_at(place, aim), _WIDE, size), size)


def _picture(world: BulletWorld, camera: Camera, size: tuple[int, int]) -> Image.Image:
    up = geometry.rotate(geometry.conjugate(camera.pose[1]), (0.0, 0.0, 1.0))
    finer = (size[0] * _FINER, size[1] * _FINER)
    picture = Image.fromarray(camera.render(world.objects, camera.window, finer).picture(up))
    return picture.resize(size, Image.Resampling.BOX)


def _camera(
    place: Vector,
    turn: geometry.Quaternion,
    angle: float,
    size: tuple[int, int],
    near: float = _NEAR,
    far: float = _FAR,
) -> Camera:
    right = math.tan(angle / 2)
    return Camera((place, turn), right, right * size[1] / size[0], near, far)


def _of_robot(world: BulletWorld, frame: str, size: tuple[int, int]) -> Camera:
    robot = world.robot
    if robot is None:
        raise NoSuchName("robot with a camera", frame, ())
    if frame not in robot.links:
        raise NoSuchName(f"frame of {robot.name}", frame, robot.links)
    position, orientation = robot.get_link_position_and_orientation(frame)
    place, turn = _vector(position), geometry.from_matrix(geometry.to_matrix(orientation))
    own = robot.description.camera if robot.description else None
    if own is None or own.frame != frame:
        return _camera(place, turn, _WIDE, size)
    return _camera(place, turn, own.horizontal_fov, size, max(own.near, _NEAR), own.far)


def _middle(world: BulletWorld) -> Vector:
    """The middle of what a plan is about: robots and all that isn't fixed; of everything if there is nothing else."""
    low, high = _bounds(world)
    return _vector((low + high) / 2)


def _bounds(world: BulletWorld) -> tuple[np.ndarray, np.ndarray]:
    chosen: list[Object] = [body for body in world.objects if not body.is_environment] or world.objects
    if not chosen:
        return np.zeros(3), np.ones(3)
    boxes = np.array([body.get_AABB() for body in chosen])
    return boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)


def _beside(world: BulletWorld, aim: Vector) -> Vector:
    """A place from which the middle is seen with all around it, over the robot's shoulder."""
    low, high = _bounds(world)
    away = 1.1 * max(1.0, float(np.linalg.norm(high - low)))
    heading = world.robot.get_orientation() if world.robot else (0.0, 0.0, 0.0, 1.0)
    direction = np.array(geometry.rotate(heading, _SIDE))
    return _vector(np.array(aim) + away * direction / np.linalg.norm(direction))


def _point(name: str, values: Sequence[float]) -> Vector:
    numbers = [float(value) for value in values]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ReplayError(f"{name} = {list(values)}: expected 3 finite numbers x, y, z in m")
    return _vector(numbers)


def _vector(values: Sequence[float] | np.ndarray) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
