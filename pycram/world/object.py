"""Objects: robots, kitchens, spoons and everything else in a world (thesis 4.3, table 4.2)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, UnknownName, WorldClosed
from pycram.foundation.refusals import refusing, refusing_methods
from pycram.models import load
from pycram.models.furniture import furniture_of, tops_of
from pycram.models.load import Model
from pycram.models.robots.description import Misfitting, RobotDescription, find_description
from pycram.models.shapes import piece_bounds
from pycram.models.surfaces import NONE, Container, Surface
from pycram.physics.body import LoadedBody
from pycram.scheduling.future import unwrap
from pycram.world import attachment, joints, overlaps
from pycram.world.attachment import BodyAttachment
from pycram.world.transaction import ReadOnlyAttributes, update
from recorder import geometry, records
from recorder.geometry import Pose, Quaternion, Vector
from recorder.records.text import overlap_texts
from recorder.tracing.call_stack import call_site
from recorder.urdf import Urdf

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld


#: Marks attributes that are None without a world, robot or description. Type checkers accept any use of such
#: attributes, so plans need no assertions.
MaybeNone: TypeAlias = Any

_SCALES = (1e-6, 1e6)  # lowest and highest scale, in m per unit of length
ENVIRONMENT = "environment"
ROBOT = "robot"


@refusing_methods("object")
class Object(ReadOnlyAttributes):
    """An object in a world.

    Positions are [x, y, z] in m and orientations are quaternions [x, y, z, w]. Without a link, poses are those of the
    base link in the world. Joint positions are in rad or m. Setting poses and joints is exact, without a simulation.
    Attributes are read-only; methods change them, and record each change.

    All methods raise BadArgument for impossible values, UnknownName for a link or movable joint that doesn't exist, and
    WorldClosed after the object was removed or its world has ended. Methods that change the object raise ChangeRefused
    while a reasoning query runs.

    Args:
        name: A unique name in the world.
        type: "environment" and "robot" have a fixed base; objects of any other type, such as "milk", are free.
        path: A .urdf, .xacro, .stl, .obj or .dae file, or the bare name of a bundled file such as ``pr2.urdf``.
        position: Position of the base link, m.
        orientation: Orientation of the base link, xyzw.
        world: None for the current world.
        color: RGBA 0..1 for a mesh; None for the mesh's own colours.
        description: Description of a robot; None to find it by the robot's name in the URDF.
        packages: Folders of ROS packages with the URDF's meshes (``package://``), or parents of such folders. Other
            packages are searched as :mod:`pycram.models.files` describes.
        scale: Number of metres in the file's unit of length: 0.001 for a file in millimetres. Masses of a URDF stay in
            kg.
        model: A model that was loaded from a recording; it replaces the file.

    Raises:
        NoWorld: No world is given, and no world is current.
        BadArgument: A value is impossible, or another object has the name.
        AssetError: The file is missing or broken.
    """

    _SUBJECT = "object"
    _CHANGED_BY = MappingProxyType(
        {
            "": "only methods of the object change it",
            "color": "use set_color(color)",
            "attachments": "use attach(other, link) and detach(other)",
            "carried": "use attach(other, link) and detach(other)",
            "carrier": "use attach(other, link) of the carrier, and detach(other)",
            "alive": "use remove()",
            "original_pose": "it is the pose at loading; use set_position_and_orientation() to move the object",
            "original_joints": "they are the positions at loading; use set_joint_positions() to move joints",
        }
    )

    def __init__(
        self,
        name: str,
        type: str,  # noqa: A002  the original's name
        path: str | Path,
        position: Sequence[float] = (0, 0, 0),
        orientation: Sequence[float] = (0, 0, 0, 1),
        world: BulletWorld | None = None,
        color: Sequence[float] | None = None,
        *,
        description: RobotDescription | None = None,
        packages: Sequence[str | Path] = (),
        scale: float = 1.0,
        model: Model | None = None,
    ) -> None:
        from pycram.world.world import BulletWorld  # noqa: PLC0415  the module pycram.world.world imports this one

        around = world if world is not None else BulletWorld.current_bullet_world
        if around is None:
            raise NoWorld
        if not isinstance(around, BulletWorld):
            raise BadArgument("world", world, "a BulletWorld")
        if description is not None and not isinstance(description, RobotDescription):
            raise BadArgument("description", description, "a RobotDescription")
        self.world: BulletWorld = around
        self.name = checks.text("name", name)
        self.type = checks.text("type", type)
        self.path = str(path)
        pose = (checks.vector("position", position), checks.quaternion("orientation", orientation))
        self.color = None if color is None else checks.color("color", color)
        self.scale = checks.in_range("scale", scale, *_SCALES)
        self.model = model or load.load(path, self.color, packages, self.scale)
        self.urdf: Urdf = self.model.urdf
        self.description: RobotDescription | MaybeNone = None
        if self.is_robot and description is not None:
            description.check(self.urdf)
            self.description = description
        elif self.is_robot:
            self.description, misfits = find_description(self.urdf)
            if misfits and model is None:  # the user saw this warning during the recording
                _warn_of_misfits(self, misfits)
        self.original_pose: Pose = pose
        self.original_joints: Mapping[str, float] = MappingProxyType({})
        self._attachments: dict[Object, BodyAttachment] = {}
        self._handle: LoadedBody | None = None
        #: Objects that this object overlapped when it was loaded; the warning :class:`Overlapping` named them.
        self.overlaps: Sequence[records.Overlap] = ()
        self._seal(Object)
        self.world.add(self)
        if model is not None:  # the user saw these warnings during the recording
            return
        if self.overlaps:
            inside = ", ".join(overlap_texts(self.name, self.overlaps, fixed=self.fixed))
            text = f"{inside}; world.settle() lifts free objects apart before a simulation"
            warnings.warn_explicit(text, overlaps.Overlapping, *call_site())
        _warn_of_shape(self)

    def __repr__(self) -> str:
        return f"Object({self.name!r}, {self.type!r})"

    def _envelope(self) -> tuple[str, int]:
        return self.world._envelope()  # noqa: SLF001  the records have the world's envelope

    def __record__(self) -> object:
        """Return the object's reference in records."""
        return {"object": self.name, "world": self.world.name}

    # --- properties --------------------------------------------------------------------------------------------------

    @property
    def is_environment(self) -> bool:
        """Whether the object is part of the environment (thesis 4.3)."""
        return self.type == ENVIRONMENT

    @property
    def is_robot(self) -> bool:
        """Whether the object is a robot."""
        return self.type == ROBOT

    @property
    def fixed(self) -> bool:
        """Whether the base is fixed to the world."""
        return self.is_environment or self.is_robot

    @property
    def handle(self) -> LoadedBody:
        """The object's body in the engine."""
        if self._handle is None:
            gone = "the world" if self.world.closed else f"object {self.name}"
            raise WorldClosed(self.world.name, f"use {self.name}", gone)
        return self._handle

    @property
    def alive(self) -> bool:
        """Whether the object is still in its world."""
        return self._handle is not None

    @property
    @refusing("object")
    def id(self) -> int:
        """PyBullet's id; after the object's removal, another body may get it."""
        return self.handle.id

    @property
    @refusing("object")
    def links(self) -> tuple[str, ...]:
        """Names of all links, the base link first."""
        return tuple(self.handle.links)

    @property
    @refusing("object")
    def base_link(self) -> str:
        """Name of the base link."""
        return self.links[0]

    @property
    @refusing("object")
    def joints(self) -> tuple[str, ...]:
        """Names of the movable joints."""
        return tuple(self.handle.joints)

    @cached_property
    def load_record(self) -> records.LoadBody:
        """The record that loads the object again, in its present colour."""
        model = self.model
        return records.LoadBody(
            body=self.name,
            type=self.type,
            path=records.escaped(self.path),
            assets=[records.Asset(path=file.name, sha256=file.sha256) for file in model.files],
            position=self.original_pose[0],
            orientation=self.original_pose[1],
            color=self.color or (),
            fixed_base=self.fixed,
            joints=self.joints,
            robot_description=self.description.text if self.description else "",
            overlaps=self.overlaps,
            loading=model.loading.to_record(),
            scale=0.0 if self.scale == 1.0 else self.scale,
        )

    def get_joint_id(self, name: str) -> int:
        """Return PyBullet's index of a movable or fixed joint."""
        if checks.text("joint", name) not in self.urdf.joints:
            raise UnknownName("joint", name, self.name, self.urdf.joints)
        return self.handle.links[self.urdf.joints[name].child]  # PyBullet gives joint and child link the same index

    def get_link_id(self, name: str) -> int:
        """Return PyBullet's index of a link; the base link has -1."""
        return self.handle.links[self.check_link(name)]

    def check_link(self, name: str | None) -> str:
        """Return the name of a link if it exists; None stands for the base link."""
        links = self.handle.links
        if name is None:
            return next(iter(links))
        if checks.text("link", name) not in links:
            raise UnknownName("link", name, self.name, links)
        return name

    def check_joint(self, name: str) -> str:
        """Return the name of a movable joint if it exists."""
        if checks.text("joint", name) not in self.handle.joints:
            raise UnknownName("movable joint", name, self.name, self.joints)
        return name

    def joint_limits(self, name: str) -> tuple[float, float]:
        """Return the lower and upper limit in rad or m; both are infinite for continuous joints."""
        joint = self.handle.joints[self.check_joint(name)]
        return joint.lower, joint.upper

    # --- furniture ---------------------------------------------------------------------------------------------------

    @property
    @refusing("object")
    def surfaces(self) -> Mapping[str, Surface]:
        """Surfaces on which objects can stand, by name; a robot has none (:mod:`pycram.models.furniture`)."""
        return NONE.surfaces if self.is_robot else furniture_of(self.model).surfaces

    @property
    @refusing("object")
    def containers(self) -> Mapping[str, Container]:
        """Drawers and doors by name; a robot has none."""
        return NONE.containers if self.is_robot else furniture_of(self.model).containers

    @property
    @refusing("object")
    def tops(self) -> tuple[Surface, ...]:
        """Surfaces on top of a free object in its present pose, such as a plate or a tray; a fixed object has none."""
        x, y, z, w = self.get_orientation()
        found = () if self.fixed else tops_of(self.model.path, (x, y, z, w))
        return tuple(replace(surface, name=f"{surface.name} of {self.name}") for surface in found)

    def surface(self, name: str) -> Surface:
        """Return the surface with a name."""
        if checks.text("surface", name) not in self.surfaces:
            raise UnknownName("surface", name, self.name, self.surfaces)
        return self.surfaces[name]

    def container(self, name: str) -> Container:
        """Return the container with a name."""
        if checks.text("container", name) not in self.containers:
            raise UnknownName("container", name, self.name, self.containers)
        return self.containers[name]

    def surface_pose(self, surface: Surface | str) -> Pose:
        """Return the pose of a surface's centre in the world at the present joint positions; its z axis points up."""
        of = surface if isinstance(surface, Surface) else self.surface(surface)
        return geometry.multiply(self.get_link_position_and_orientation(of.link), of.pose)

    # --- poses and joints --------------------------------------------------------------------------------------------

    def get_position(self) -> list[float]:
        """Return the position [x, y, z] in m."""
        return self.get_position_and_orientation()[0]

    def get_pose(self) -> list[float]:
        """Return the position [x, y, z] in m; the orientation isn't part of it (thesis, table 4.2)."""
        return self.get_position()

    def get_orientation(self) -> list[float]:
        """Return the orientation [x, y, z, w]."""
        return self.get_position_and_orientation()[1]

    def get_position_and_orientation(self) -> tuple[list[float], list[float]]:
        """Return the position [x, y, z] in m and the orientation [x, y, z, w] of the base link in the world."""
        with self.world.lock:
            position, orientation = self.world.engine.pose(self.handle)
        return list(position), list(orientation)

    def get_link_position(self, name: str) -> list[float]:
        """Return the position of a link's frame."""
        return self.get_link_position_and_orientation(name)[0]

    def get_link_orientation(self, name: str) -> list[float]:
        """Return the orientation of a link's frame."""
        return self.get_link_position_and_orientation(name)[1]

    def get_link_position_and_orientation(self, name: str) -> tuple[list[float], list[float]]:
        """Return the position and orientation of a link's frame."""
        with self.world.lock:
            position, orientation = self.world.engine.link_pose(self.handle, self.check_link(name))
        return list(position), list(orientation)

    def get_joint_position(self, name: str) -> float:
        """Return the position of a joint in rad or m."""
        with self.world.lock:
            return self.world.engine.joint(self.handle, self.check_joint(name))

    def get_joint_positions(self) -> dict[str, float]:
        """Return the positions of all movable joints by name."""
        with self.world.lock:
            return dict(zip(self.joints, self.world.engine.joints(self.handle)[0], strict=True))

    def get_AABB(self, name: str | None = None) -> tuple[list[float], list[float]]:  # noqa: N802  the original's name
        """Return the lowest and highest corner of the axis-aligned box around the object, or around one link.

        The box is up to 3 mm too large on each side, because the engine pads shapes.
        """
        with self.world.lock:
            links = self.links if name is None else (self.check_link(name),)
            boxes = self.world.engine.boxes((self.handle, link) for link in links)
        return (
            [min(box[0][i] for box in boxes) for i in range(3)],
            [max(box[1][i] for box in boxes) for i in range(3)],
        )

    # --- changes -----------------------------------------------------------------------------------------------------

    def set_position_and_orientation(self, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Set the pose. Attached objects move along; a carried object gets a new relative pose."""
        self._move(checks.vector("position", position), checks.quaternion("orientation", orientation))

    def set_position(self, position: Sequence[float], orientation: Sequence[float] | None = None) -> None:
        """Set the position, and the orientation if it is given."""
        turned = None if orientation is None else checks.quaternion("orientation", orientation)
        self._move(checks.vector("position", position), turned)

    def set_orientation(self, orientation: Sequence[float]) -> None:
        """Set the orientation; the origin of the base link doesn't move."""
        self._move(None, checks.quaternion("orientation", orientation))

    def _move(self, position: Vector | None, orientation: Quaternion | None) -> None:
        """Set the pose; a part that is None keeps its value at the start of the transaction."""
        with self.world.transactions.begin(records.Mutation(move_body=records.MoveBody(body=self.name))) as transaction:
            self.world.trajectories.refuse("set its pose", self)
            now = self.world.engine.pose(self.handle)
            pose = (position or now[0], orientation or now[1])
            command = transaction.command.move_body
            command.position[:], command.orientation[:] = pose
            self.world.engine.set_pose(self.handle, pose)
            transaction.mark_modified(self)
            attachment.move_attached(self, transaction)
            attachment.renew(self, transaction)
            if self.is_environment:
                transaction.fire(self.world.get_manipulation_event(), self)

    def set_joint_position(self, name: str, position: float) -> None:
        """Set the position of one joint; see :meth:`set_joint_positions`."""
        self.set_joint_positions({name: position})

    def set_joint_positions(self, positions: Mapping[str, float]) -> None:
        """Set positions (rad or m) of joints by name; objects on moving links and in drawers move along.

        Raises:
            JointLimitError: A position is outside the joint's limits.
        """
        joints.set_positions(self, positions)

    def remove(self) -> None:
        """Remove the object from its world, and end its attachments."""
        self.world.remove(self)

    # --- attachments -------------------------------------------------------------------------------------------------

    @property
    def attachments(self) -> Mapping[Object, BodyAttachment]:
        """All attachments in which the object is the carrier or is carried; the key is the other object."""
        return MappingProxyType(self._attachments)

    @property
    def carried(self) -> list[BodyAttachment]:
        """The attachments in which the object is the carrier."""
        return [held for held in self._attachments.values() if held.carrier is self]

    @property
    def carrier(self) -> Object | None:
        """The object that carries this object; None without a carrier."""
        return next((held.carrier for held in self._attachments.values() if held.body is self), None)

    def attach(self, other: Object, link: str | None = None, other_link: str | None = None) -> None:
        """Carry another object at its present relative pose (thesis 4.3.1); an attachment that exists doesn't change.

        If only the other object has a fixed base, as robots and furniture have, that object becomes the carrier.

        Args:
            link: The link of this object; None for its base link.
            other_link: The link of the other object; None for its base link.

        Raises:
            AttachmentError: Both bases are fixed, another object carries the other object, there is a circle of
                carriers, or the worlds differ.
        """
        attachment.attach(self, _object("other", other), link, other_link)

    def detach(self, other: Object) -> None:
        """End an attachment, from either side (thesis 4.3.2); neither object moves.

        Warns:
            StillHeld: Closed fingers of a robot still hold the object.

        Raises:
            AttachmentError: The objects aren't attached to each other.
        """
        released = _object("other", other)
        attachment.detach(self, released)
        for robot, body in ((self, released), (released, self)):
            if robot.is_robot and (arm := attachment.gripping(robot, body)):
                held = f"the fingers of the {arm} gripper still hold {body.name} by friction"
                text = f"{held}; open the gripper (opening-gripper) to release the object"
                warnings.warn_explicit(text, attachment.StillHeld, *call_site())

    def detach_all(self) -> None:
        """End all attachments in which the object is the carrier or is carried."""
        while self._attachments:
            self.detach(next(iter(self._attachments)))

    def set_color(self, color: Sequence[float]) -> None:
        """Set the colour of all links, RGBA 0..1."""
        rgba = checks.color("color", color)
        with self.world.transactions.begin(records.Mutation(set_color=records.SetColor(body=self.name, color=rgba))):
            self.world.engine.set_color(self.handle, rgba)
            update(self, color=rgba)
            vars(self).pop("load_record", None)


def _object(argument: str, value: object) -> Object:
    result = unwrap(value)
    if not isinstance(result, Object):
        raise BadArgument(argument, result, "an Object")
    return result


def _warn_of_shape(body: Object) -> None:
    """Warn that an object's mesh is probably in millimetres, or that hollow meshes of a URDF are filled."""
    is_mesh = not body.path.lower().endswith((".urdf", ".xacro"))  # lengths in a URDF are always in m
    wide = width(body.model.path) if is_mesh and not body.fixed else 0.0
    if wide > _WIDEST:
        text = f"{body.name} is {wide:.3g} m wide: is its file in millimetres? Object(..., scale=0.001)"
        warnings.warn_explicit(text, Oversized, *call_site())
    if not is_mesh and not body.is_robot and (filled := load.filled_links(body.model)):
        names = ", ".join(filled[:_NAMED]) + (f" and {len(filled) - _NAMED} more" if len(filled) > _NAMED else "")
        text = (
            f"{body.name}: the collision mesh of {names} is hollow and in one piece, so the engine takes its solid "
            "convex hull; write its convex parts as an OBJ with a group for each, or as several <collision> elements"
        )
        warnings.warn_explicit(text, Filled, *call_site())


def _warn_of_misfits(robot: Object, misfits: Mapping[str, str]) -> None:
    """Warn that parts of a robot's description, which was found by its name, don't fit its URDF."""
    remedy = "'pycram describe' writes a fitting description for Object(..., description=RobotDescription.load(FILE))"
    if robot.description is None:
        what = f"no description: {robot.urdf.name}'s description doesn't fit its URDF ({next(iter(misfits.values()))})"
    else:
        out = "; ".join(f"{part} ({reason})" for part, reason in misfits.items())
        what = f"a description without these parts, which don't fit its URDF: {out}"
    warnings.warn_explicit(f"{robot.name} has {what}; {remedy}", Misfitting, *call_site())


_WIDEST: Final = 10.0  # maximum width in m of a free object's mesh; the unit of wider meshes is probably wrong
_NAMED: Final = 5  # maximum number of links that a warning names


class Oversized(UserWarning):
    """The mesh of a free object is wider than 10 m, so its file is probably in another unit than metres."""


class Filled(UserWarning):
    """A URDF has a hollow collision mesh in one piece. The engine uses the mesh's convex hull, so nothing gets in."""


def width(model: Path) -> float:
    """Return the largest extent of a link of a checked URDF, in m."""
    lows: dict[str, list[float]] = {}
    highs: dict[str, list[float]] = {}
    for link, (low, high) in piece_bounds(model):
        lows[link] = [*map(min, low, lows.get(link, low))]
        highs[link] = [*map(max, high, highs.get(link, high))]
    return max(
        (top - bottom for link in lows for bottom, top in zip(lows[link], highs[link], strict=True)), default=0.0
    )
