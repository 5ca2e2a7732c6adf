"""Pictures of any step, without a viewer and without the physics engine: the folded state, drawn by our rasterizer.

A picture is taken by a camera of the robot, as it was directed then; from a point to a point; or, by default, from a
viewpoint that shows the robot and the movable objects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation.failures import PycramError
from recorder import geometry
from recorder.packages import needed
from replay.errors import Damaged, NoSuchName, ReplayError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from recorder.geometry import Pose, Vector
    from replay.explain.causes.why_data import Why
    from replay.file.record_reader import RecordReader
    from replay.state.state import Body

with needed("render"):
    from PIL import Image

    from pycram.models.visual import shapes_of
    from pycram.vision.camera import Camera, Drawable
    from replay.restore.recorded_world import description_of, model_of, world_state

_FIELD_OF_VIEW: Final = math.radians(60)  # horizontal, of cameras without one
_NEAR, _FAR = 0.02, 30.0  # m
#: Default directions from the middle to the viewpoint, in the robot's frame: the first from which enough is seen.
_SIDES: Final = (
    (-0.55, -0.65, 0.55),
    (-0.55, 0.65, 0.55),
    (0.55, -0.65, 0.55),
    (0.55, 0.65, 0.55),
    (-0.4, 0.0, 0.9),
)
_ENOUGH: Final = 0.5  # of robots and movable objects that furniture and walls leave to be seen
_GLANCE: Final = (80, 60)  # pixels of a picture that tells that
_PADDING: Final = 0.004  # m around collision shapes, as the physics engine has it
_OVERSAMPLING: Final = 2  # pixels a side that are averaged to one: edges are smooth then
_MAX_SIDE: Final = 4096  # pixels


@dataclass(frozen=True, slots=True)
class _Drawn:
    """A body with where its links are, in the world."""

    body: Body
    frames: Mapping[str, Pose]
    drawable: Drawable
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class Scene:
    """The bodies of a world after a step, ready to be drawn.

    Raises:
        NotRestored: no world was open then.
        Damaged: records or files are lost, or make no sense.
    """

    def __init__(self, log: RecordReader, step: int, world: str | None = None) -> None:
        state = world_state(log, step, world)
        try:
            self._bodies = {name: _drawn(log, body) for name, body in state.bodies.items()}
        except (PycramError, ValueError) as error:
            raise Damaged(log.path, f"the world after step {step}", str(error)) from error
        self._robot = self._bodies.get(state.robot)

    @property
    def camera(self) -> str:
        """Frame of the robot's camera; "" if there is no robot, or its description names none."""
        description = description_of(self._robot.body.loaded.robot_description) if self._robot else None
        return description.camera.frame if description and description.camera else ""

    def picture(
        self,
        *,
        camera: str | None = None,
        eye: Sequence[float] | None = None,
        target: Sequence[float] | None = None,
        size: tuple[int, int] = (640, 480),
    ) -> Image.Image:
        """Return a picture of it.

        Args:
            camera: a frame of the robot, as "wide_stereo_optical_frame"; with the field of view and the range of the
                robot's camera if it is that one's.
            eye: viewpoint, xyz in m; by default over the robot's shoulder.
            target: point in the middle of the picture, xyz in m; by default the middle of robot and movable objects.
            size: width and height in pixels, up to 4096 each.

        Raises:
            NoSuchName: there is no such frame.
            ReplayError: the size or a point is impossible.
        """
        if not all(isinstance(side, int) and 0 < side <= _MAX_SIDE for side in size):
            raise ReplayError(f"a picture can't have {size[0]} x {size[1]} pixels; take 1 to {_MAX_SIDE} a side")
        if camera is not None:
            return self._draw(self._robot_camera(camera, size), size)
        low, high = self._bounds()
        aim = _vector((low + high) / 2) if target is None else _point("target", target)
        viewpoint = self._viewpoint(aim, low, high) if eye is None else _point("eye", eye)
        if math.dist(viewpoint, aim) < 1e-6:
            raise ReplayError(f"a picture from {list(viewpoint)} to the same point has no direction")
        return self._draw(_pinhole((viewpoint, geometry.look_at(viewpoint, aim)), _FIELD_OF_VIEW, size), size)

    def _draw(self, camera: Camera, size: tuple[int, int]) -> Image.Image:
        up = geometry.rotate(geometry.conjugate(camera.pose[1]), (0.0, 0.0, 1.0))
        finer = (size[0] * _OVERSAMPLING, size[1] * _OVERSAMPLING)
        sight = camera.draw([drawn.drawable for drawn in self._bodies.values()], camera.window, finer)
        return Image.fromarray(sight.picture(up)).resize(size, Image.Resampling.BOX)

    def _robot_camera(self, frame: str, size: tuple[int, int]) -> Camera:
        """Return the camera at a frame of the robot."""
        if self._robot is None:
            raise NoSuchName("robot with a camera", frame, ())
        if frame not in self._robot.frames:
            raise NoSuchName(f"frame of {self._robot.body.name}", frame, self._robot.frames)
        description = description_of(self._robot.body.loaded.robot_description)
        own = description.camera if description else None
        if own is None or own.frame != frame:
            return _pinhole(self._robot.frames[frame], _FIELD_OF_VIEW, size)
        return _pinhole(own.pose(self._robot.frames[frame]), own.horizontal_fov, size, max(own.near, _NEAR), own.far)

    def _bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return lowest and highest corner of robots and movable objects; of everything if there are none."""
        movable = [drawn for drawn in self._bodies.values() if drawn.body.type != "environment"]
        chosen = movable or list(self._bodies.values())
        if not chosen:
            return np.zeros(3), np.ones(3)
        return np.min([drawn.low for drawn in chosen], axis=0), np.max([drawn.high for drawn in chosen], axis=0)

    def _viewpoint(self, aim: Vector, low: NDArray[np.float64], high: NDArray[np.float64]) -> Vector:
        """Return a viewpoint over the robot's shoulder from which a box is seen whole, and not behind a wall."""
        distance = 1.1 * max(1.0, float(np.linalg.norm(high - low)))
        heading = self._robot.body.orientation if self._robot else (0.0, 0.0, 0.0, 1.0)
        found: dict[Vector, float] = {}
        for side in _SIDES:
            direction = np.array(geometry.rotate(heading, side))
            viewpoint = _vector(np.array(aim) + distance * direction / np.linalg.norm(direction))
            found[viewpoint] = self._seen(viewpoint, aim)
            if found[viewpoint] >= _ENOUGH:
                return viewpoint
        return max(found, key=lambda viewpoint: found[viewpoint])

    def _seen(self, viewpoint: Vector, aim: Vector) -> float:
        """Return which share of robots and movable objects is seen from a viewpoint, of what could be."""
        camera = _pinhole((viewpoint, geometry.look_at(viewpoint, aim)), _FIELD_OF_VIEW, _GLANCE)
        bodies = sorted(self._bodies.values(), key=lambda drawn: drawn.body.type == "environment")
        chosen = [drawn.drawable for drawn in bodies if drawn.body.type != "environment"]
        alone = camera.draw(chosen, camera.window, _GLANCE).bodies >= 0
        among = camera.draw([drawn.drawable for drawn in bodies], camera.window, _GLANCE).bodies
        shown = (among >= 0) & (among < len(chosen))
        return float(shown.sum() / alone.sum()) if alone.any() else float(not chosen)


def write_pictures(log: RecordReader, why: Why, folder: Path) -> list[Path]:
    """Write the pictures of an explained failure, and return their files.

    Raises:
        ReplayError: they can't be drawn or written.
    """
    files = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not why.bodies:
            return []
        scene = Scene(log, why.step, why.world.name if why.world is not None else None)
        if scene.camera:
            files.append(folder / f"step_{why.step}_robot.png")
            scene.picture(camera=scene.camera).save(files[-1])
        files.append(folder / f"step_{why.step}_side.png")
        scene.picture(target=_middle(why)).save(files[-1])
    except OSError as error:
        raise ReplayError(f"{folder}: {error.strerror or error}") from error
    return files


def _middle(why: Why) -> Vector:
    """Return a point between robot and objects, at the height of the objects."""
    positions = [involved.body.position for involved in why.bodies]
    x, y = (sum(position[axis] for position in positions) / len(positions) for axis in (0, 1))
    return x, y, max(position[2] for position in positions)


def _drawn(log: RecordReader, body: Body) -> _Drawn:
    model = model_of(log, body.loaded)
    frames = {link: geometry.multiply(body.pose, pose) for link, pose in model.urdf.link_poses(body.joints).items()}
    shapes = shapes_of(model.path)
    drawable = Drawable(shapes, *_poses(frames, shapes.links), body.color or None, body.type == "robot")
    return _Drawn(body, frames, drawable, *_box(model.path, frames))


def _poses(frames: Mapping[str, Pose], links: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (n, 3) and orientations (n, 4) of links."""
    positions = np.array([frames[link][0] for link in links]).reshape(-1, 3)
    return positions, np.array([frames[link][1] for link in links]).reshape(-1, 4)


def _box(path: Path, frames: Mapping[str, Pose]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of a box around all link frames and the boxes of all collision shapes."""
    shapes = shapes_of(path, "collision")
    positions, orientations = _poses(frames, shapes.links)
    turns = geometry.to_matrices(orientations)
    middles = positions + np.einsum("kij,kj->ki", turns, (shapes.low + shapes.high) / 2)
    reach = np.einsum("kij,kj->ki", np.abs(turns), (shapes.high - shapes.low) / 2) + _PADDING
    origins = _poses(frames, list(frames))[0]
    return np.vstack([origins, middles - reach]).min(axis=0), np.vstack([origins, middles + reach]).max(axis=0)


def _pinhole(pose: Pose, angle: float, size: tuple[int, int], near: float = _NEAR, far: float = _FAR) -> Camera:
    right = math.tan(angle / 2)
    return Camera(pose, right, right * size[1] / size[0], near, far)


def _point(name: str, values: Sequence[float]) -> Vector:
    numbers = [float(value) for value in values]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ReplayError(f"{name} = {list(values)}: expected 3 finite numbers x, y, z in m")
    return _vector(numbers)


def _vector(values: Sequence[float] | NDArray[np.float64]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
