"""Objects: everything in a world is one, robot, kitchen or spoon (thesis 4.3, table 4.2).

Positions are [x, y, z] in m, orientations quaternions [x, y, z, w], both of the base link in the world frame, unless a
link is named. Setting a pose is exact and runs no physics. Joints are named and their values are in rad or m.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, JointLimitError, NoWorld, UnknownName, WorldClosed
from pycram.models import load
from pycram.models.robots.description import RobotDescription, find_description
from pycram.scheduling.future import unwrap
from pycram.world import attachment, carried
from recorder import records

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pycram.models.load import Model
    from pycram.physics.body import Body
    from pycram.world.attachment import Attachment
    from pycram.world.transaction import Change
    from pycram.world.world import BulletWorld
    from recorder.geometry import Pose
    from recorder.geometry.urdf import Urdf

ENVIRONMENT = "environment"
ROBOT = "robot"
_LIMIT_SLACK = 1e-6  # rad or m: rounding of what was read before is no error


class Object:
    """A thing in a world.

    Args:
        name: how it is called; unique in its world.
        type: what it is: "environment" and "robot" have a fixed base, anything else ("milk") is free.
        path: .urdf, .stl, .obj or .dae file; a bare name also finds PyCRAM's own resources and ``pr2.urdf``.
        position: of its base link, m.
        orientation: of its base link, xyzw.
        world: where it appears; the current world by default.
        color: RGBA 0..1 for a mesh; None leaves it the colours that it has.
        description: of a robot; by default found by the name in its URDF.
        model: what the path would give, if it is there already, as from a recording.

    Raises:
        NoWorld: no world is given and none is current.
        BadArgument: a value that can't be, or a name that is taken.
        AssetError: the file is missing or broken.
        WorldClosed: the world has ended.
        ChangeRefused: a reasoning query runs in the world.
    """

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
        model: Model | None = None,
    ) -> None:
        from pycram.world.world import BulletWorld  # noqa: PLC0415  worlds hold objects

        place = world if world is not None else BulletWorld.current_bullet_world
        if place is None:
            raise NoWorld
        if not isinstance(place, BulletWorld):
            raise BadArgument("world", world, "a BulletWorld")
        if description is not None and not isinstance(description, RobotDescription):
            raise BadArgument("description", description, "a RobotDescription")
        self.world: BulletWorld = place
        self.name = checks.text("name", name)
        self.type = checks.text("type", type)
        self.path = str(path)
        pose = (checks.vector("position", position), checks.quaternion("orientation", orientation))
        self.color = None if color is None else checks.color("color", color)
        self.model = model or load.load(path, self.color)
        self.urdf: Urdf = self.model.urdf
        self.description: RobotDescription | None = None
        if self.is_robot:
            self.description = description or find_description(self.urdf.name)
            if self.description is not None:
                self.description.check(self.urdf)
        self.original_pose: Pose = pose
        self.original_joints: dict[str, float] = {}
        self._attachments: dict[Object, Attachment] = {}
        self._handle: Body | None = None
        self.world.add(self)

    def __repr__(self) -> str:
        return f"Object({self.name!r}, {self.type!r})"

    def __record__(self) -> object:
        """How it stands in records."""
        return {"object": self.name, "world": self.world.name}

    # --- what it is ------------------------------------------------------------------------------------------------

    @property
    def is_environment(self) -> bool:
        """Whether it is part of the environment (thesis 4.3)."""
        return self.type == ENVIRONMENT

    @property
    def is_robot(self) -> bool:
        """Whether it is a robot."""
        return self.type == ROBOT

    @property
    def fixed(self) -> bool:
        """Whether its base stays where it is put."""
        return self.is_environment or self.is_robot

    @property
    def handle(self) -> Body:
        """The engine's side of it.

        Raises:
            WorldClosed: it was removed, or its world has ended.
        """
        if self._handle is None:
            gone = "the world" if self.world.closed else f"object {self.name}"
            raise WorldClosed(self.world.name, f"use {self.name}", gone)
        return self._handle

    @handle.setter
    def handle(self, handle: Body | None) -> None:
        self._handle = handle

    @property
    def alive(self) -> bool:
        """Whether it still is in its world."""
        return self._handle is not None

    @property
    def id(self) -> int:
        """PyBullet's id; another body may get it after this one's removal."""
        return self.handle.id

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links, the base link first."""
        return tuple(self.handle.links)

    @property
    def base_link(self) -> str:
        """Name of the base link."""
        return self.links[0]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the movable joints."""
        return tuple(self.handle.joints)

    @property
    def load_record(self) -> records.LoadBody:
        """What a recording needs to load it again."""
        model = self.model
        return records.LoadBody(
            body=self.name,
            type=self.type,
            path=self.path,
            assets=[records.Asset(path=file.name, sha256=file.sha256) for file in model.files],
            position=self.original_pose[0],
            orientation=self.original_pose[1],
            color=self.color or (),
            fixed_base=self.fixed,
            joints=self.joints,
            robot_description=self.description.text if self.description else "",
        )

    def get_joint_id(self, name: str) -> int:
        """PyBullet's index of a joint, movable or fixed.

        Raises:
            UnknownName: there is no such joint.
        """
        if checks.text("joint", name) not in self.urdf.joints:
            raise UnknownName("joint", name, self.name, self.urdf.joints)
        return self.handle.links[self.urdf.joints[name].child]  # PyBullet's joints and their child links share numbers

    def get_link_id(self, name: str) -> int:
        """PyBullet's index of a link; -1 is the base link.

        Raises:
            UnknownName: there is no such link.
        """
        return self.handle.links[self.check_link(name)]

    def check_link(self, name: str | None) -> str:
        """A link's name, the base link's for None.

        Raises:
            UnknownName: there is no such link.
        """
        links = self.handle.links
        if name is None:
            return next(iter(links))
        if checks.text("link", name) not in links:
            raise UnknownName("link", name, self.name, links)
        return name

    def check_joint(self, name: str) -> str:
        """A joint's name.

        Raises:
            UnknownName: there is no such movable joint.
        """
        if checks.text("joint", name) not in self.handle.joints:
            raise UnknownName("movable joint", name, self.name, self.joints)
        return name

    def joint_limits(self, name: str) -> tuple[float, float]:
        """Lower and upper limit in rad or m; infinite for continuous joints.

        Raises:
            UnknownName: there is no such movable joint.
        """
        joint = self.handle.joints[self.check_joint(name)]
        return joint.lower, joint.upper

    # --- where it is -----------------------------------------------------------------------------------------------

    def get_position(self) -> list[float]:
        """Position [x, y, z] in m."""
        return self.get_position_and_orientation()[0]

    def get_pose(self) -> list[float]:
        """The same as :meth:`get_position` (thesis, table 4.2)."""
        return self.get_position()

    def get_orientation(self) -> list[float]:
        """Orientation [x, y, z, w]."""
        return self.get_position_and_orientation()[1]

    def get_position_and_orientation(self) -> tuple[list[float], list[float]]:
        """Position and orientation."""
        with self.world.lock:
            position, orientation = self.world.engine.pose(self.handle)
        return list(position), list(orientation)

    def get_link_position(self, name: str) -> list[float]:
        """Position of a link's frame.

        Raises:
            UnknownName: there is no such link.
        """
        return self.get_link_position_and_orientation(name)[0]

    def get_link_orientation(self, name: str) -> list[float]:
        """Orientation of a link's frame.

        Raises:
            UnknownName: there is no such link.
        """
        return self.get_link_position_and_orientation(name)[1]

    def get_link_position_and_orientation(self, name: str) -> tuple[list[float], list[float]]:
        """Position and orientation of a link's frame.

        Raises:
            UnknownName: there is no such link.
        """
        with self.world.lock:
            position, orientation = self.world.engine.link_pose(self.handle, self.check_link(name))
        return list(position), list(orientation)

    def get_joint_position(self, name: str) -> float:
        """Value of a joint in rad or m.

        Raises:
            UnknownName: there is no such movable joint.
        """
        with self.world.lock:
            return self.world.engine.joint(self.handle, self.check_joint(name))

    def get_joint_positions(self) -> dict[str, float]:
        """Values of all movable joints."""
        with self.world.lock:
            return dict(zip(self.joints, self.world.engine.joints(self.handle)[0], strict=True))

    def get_AABB(self, name: str | None = None) -> tuple[list[float], list[float]]:  # noqa: N802  the original's name
        """Lowest and highest corner of the box around it, or around one of its links, along the world's axes.

        The engine pads shapes: the box is up to 3 mm larger on each side.

        Raises:
            UnknownName: there is no such link.
        """
        with self.world.lock:
            engine = self.world.engine
            links = self.links if name is None else (self.check_link(name),)
            boxes = [engine.box(self.handle, link) for link in links]
        return (
            [min(box[0][i] for box in boxes) for i in range(3)],
            [max(box[1][i] for box in boxes) for i in range(3)],
        )

    # --- moving it -------------------------------------------------------------------------------------------------

    def set_position_and_orientation(self, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Puts it there, with all that it carries; no physics runs.

        If something carries it, it moves alone and is carried on with its new relative pose.

        Raises:
            BadArgument: no position or orientation.
        """
        pose = (checks.vector("position", position), checks.quaternion("orientation", orientation))
        command = records.MoveBody(body=self.name, position=pose[0], orientation=pose[1])
        with self.world.transactions.change(records.Mutation(move_body=command)) as change:
            self.world.engine.set_pose(self.handle, pose)
            change.touch(self)
            carried.follow(self, change)
            attachment.renew(self, change)
            self._announce_manipulation(change)

    def set_position(self, position: Sequence[float], orientation: Sequence[float] | None = None) -> None:
        """Puts it at a position, keeping its orientation unless one is given.

        Raises:
            BadArgument: no position or orientation.
        """
        with self.world.lock:
            kept = self.get_orientation() if orientation is None else orientation
            self.set_position_and_orientation(position, kept)

    def set_orientation(self, orientation: Sequence[float]) -> None:
        """Turns it where it is.

        Raises:
            BadArgument: no orientation.
        """
        with self.world.lock:
            self.set_position_and_orientation(self.get_position(), orientation)

    def set_joint_position(self, name: str, position: float) -> None:
        """Puts one joint to a value; see :meth:`set_joint_positions`."""
        self.set_joint_positions({name: position})

    def set_joint_positions(self, positions: Mapping[str, float]) -> None:
        """Puts joints to values, with all that is attached to their links or lies in a drawer; no physics runs.

        Args:
            positions: values in rad or m by joint name.

        Raises:
            UnknownName: there is no such movable joint.
            BadArgument: not a number.
            JointLimitError: outside the joint's limits.
        """
        if not isinstance(positions, Mapping):
            raise BadArgument("positions", positions, "values by joint name, such as {'torso_lift_joint': 0.2}")
        checked = {name: self._check_value(name, value) for name, value in positions.items()}
        command = records.MoveJoints(body=self.name, joints=list(checked), positions=list(checked.values()))
        with self.world.transactions.change(records.Mutation(move_joints=command)) as change:
            self.move_joints(checked, change)

    def _check_value(self, name: str, value: float) -> float:
        lower, upper = self.joint_limits(name)
        checked = checks.number(f"joint {name}", value)
        if not lower - _LIMIT_SLACK <= checked <= upper + _LIMIT_SLACK:
            raise JointLimitError(self.name, name, checked, lower, upper)
        return checked

    def move_joints(self, positions: Mapping[str, float], change: Change) -> None:
        """The part of a change that moves joints.

        Args:
            positions: checked values by joint name.
            change: notes what moved.
        """
        engine = self.world.engine
        links = [] if self.is_robot else carried.moved_links(self.urdf, positions)
        riding = carried.riders(self, links) if links else {}
        before = {link: engine.link_pose(self.handle, link) for link in set(riding.values())}
        engine.set_joints(self.handle, positions)
        change.touch(self)
        carried.ride(self, before, riding, change)
        carried.follow(self, change)
        self._announce_manipulation(change)

    def _announce_manipulation(self, change: Change) -> None:
        if self.is_environment:
            change.events.append(lambda: self.world.get_manipulation_event().prepare(self))

    def remove(self) -> None:
        """Takes it out of its world; what it carries is let go, and so is it by its carrier.

        Raises:
            WorldClosed: it was removed before.
        """
        self.world.take_out(self)

    # --- attachments -----------------------------------------------------------------------------------------------

    @property
    def attachments(self) -> Mapping[Object, Attachment]:
        """All attachments that it is part of, by the other object; both sides list them."""
        return MappingProxyType(self._attachments)

    @property
    def carried(self) -> list[Attachment]:
        """Attachments in which it is the carrier."""
        return [held for held in self._attachments.values() if held.carrier is self]

    @property
    def carrier(self) -> Object | None:
        """What carries it."""
        return next((held.carrier for held in self._attachments.values() if held.body is self), None)

    def attach(self, other: Object, link: str | None = None, other_link: str | None = None) -> None:
        """From now on carries another object with one of its links (thesis 4.3.1).

        An attachment that exists already is left as it is.

        Args:
            other: the object to carry; it keeps its full relative pose.
            link: the link that carries; the base link by default.
            other_link: the link of the other that is held; its base link by default.

        Raises:
            UnknownName: there is no such link.
            BadArgument: the other isn't an object.
            AttachmentError: it makes no sense (cycle, fixed base, carried by another, another world).
        """
        attachment.attach(self, _object("other", other), link, other_link)

    def detach(self, other: Object) -> None:
        """Ends an attachment, from either side (thesis 4.3.2); both stay where they are.

        Raises:
            BadArgument: the other isn't an object.
            AttachmentError: there is none between the two.
        """
        attachment.detach(self, _object("other", other))

    def detach_all(self) -> None:
        """Ends all attachments that it is part of."""
        for other in list(self._attachments):
            self.detach(other)

    def set_color(self, color: Sequence[float]) -> None:
        """Paints all of it.

        Args:
            color: RGBA 0..1.

        Raises:
            BadArgument: not a colour.
        """
        rgba = checks.color("color", color)
        command = records.SetColor(body=self.name, color=rgba)
        with self.world.transactions.change(records.Mutation(set_color=command)):
            self.world.engine.set_color(self.handle, rgba)
            self.color = rgba


def _object(argument: str, value: object) -> Object:
    """An object, the result where it is a branch's handle."""
    result = unwrap(value)
    if not isinstance(result, Object):
        raise BadArgument(argument, result, "an Object")
    return result
