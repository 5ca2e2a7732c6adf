"""What is true of worlds after a step: plain data, without a physics engine."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from recorder import geometry
from recorder.urdf import Urdf, UrdfError
from replay.errors import NoSuchName

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.records import LoadBody


@dataclass(slots=True)
class Body:
    """A body.

    Attributes:
        name: its name.
        type: what it is ("robot", "environment", "milk", ...).
        loaded: how it was loaded.
        position: of its base link in the world, m.
        orientation: of its base link, xyzw.
        velocity: linear (m/s) and angular (rad/s).
        joints: values by name, rad or m.
        joint_velocities: by name, rad/s or m/s.
        color: RGBA if it was painted, else empty.
    """

    name: str
    type: str
    loaded: LoadBody
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    velocity: tuple[float, ...] = (0.0,) * 6
    joints: dict[str, float] = field(default_factory=dict)
    joint_velocities: dict[str, float] = field(default_factory=dict)
    color: tuple[float, ...] = ()

    @property
    def pose(self) -> Pose:
        """Position and orientation."""
        return self.position, self.orientation


@dataclass(frozen=True, slots=True)
class Attachment:
    """One body carried by another.

    Attributes:
        carrier: name of the body that carries.
        carrier_link: its link.
        body: name of the carried one.
        body_link: the link that is held.
        position: of the carried one's base in the carrier's link, m.
        orientation: xyzw.
    """

    carrier: str
    carrier_link: str
    body: str
    body_link: str
    position: Vector
    orientation: Quaternion


@dataclass(slots=True)
class World:
    """A world.

    Attributes:
        name: its name.
        mode: "DIRECT" or "GUI".
        sim_step: simulated steps of 1/240 s.
        gravity: m/s^2.
        realtime: whether it runs at the pace of the clock.
        robot: name of the robot that plans control, or "".
        bodies: by name, in the order of loading.
        attachments: by carrier and body.
    """

    name: str
    mode: str = "DIRECT"
    sim_step: int = 0
    gravity: Vector = (0.0, 0.0, 0.0)
    realtime: bool = False
    robot: str = ""
    bodies: dict[str, Body] = field(default_factory=dict)
    attachments: dict[tuple[str, str], Attachment] = field(default_factory=dict)

    def body(self, name: str) -> Body:
        """A body by name.

        Raises:
            NoSuchName: there is none.
        """
        if name not in self.bodies:
            raise NoSuchName("object", name, self.bodies)
        return self.bodies[name]


@dataclass(frozen=True)
class State:
    """Everything after a step.

    Attributes:
        step: the step.
        worlds: the open worlds by name.
        asset: reads an attached file of the recording.
    """

    step: int
    worlds: Mapping[str, World]
    asset: Callable[[str], bytes] = field(repr=False)

    def world(self, name: str | None = None) -> World:
        """A world by name, or the only one, or the one opened last.

        Raises:
            NoSuchName: there is none.
        """
        if name is None and self.worlds:
            return list(self.worlds.values())[-1]
        if name is None or name not in self.worlds:
            raise NoSuchName("open world", name or "", self.worlds)
        return self.worlds[name]

    @cached_property
    def _models(self) -> dict[str, Urdf]:
        return {}

    def urdf(self, body: Body) -> Urdf:
        """The model of a body, from the recording.

        Raises:
            NoSuchName: the recording doesn't have it.
        """
        asset = body.loaded.assets[0]
        key = f"{asset.sha256}/{asset.path}"
        if key not in self._models:
            try:
                self._models[key] = Urdf.parse(self.asset(key))
            except KeyError:
                raise NoSuchName("attached model", key, ()) from None
        return self._models[key]

    def link_pose(self, body: Body, link: str) -> Pose:
        """Pose of a link in the world.

        Raises:
            NoSuchName: there is no such link.
        """
        model = self.urdf(body)
        try:
            return geometry.multiply(body.pose, model.forward_kinematics(body.joints, link))
        except UrdfError:
            raise NoSuchName("link", link, model.links) from None
