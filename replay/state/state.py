"""What is true of worlds after a step: plain data, without a physics engine. Each state has its own mappings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from recorder.records import STEPS_PER_SECOND
from replay.errors import NoSuchName
from replay.file.lifetimes import title

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.geometry.urdf import Urdf
    from recorder.records import LoadBody
    from replay.file.assets import Assets


@dataclass(frozen=True, slots=True)
class Body:
    """A body.

    Attributes:
        name: its name.
        type: what it is ("robot", "environment", "milk", ...).
        loaded: the record of how it was loaded: models, pose then, robot description.
        position: of its base link in the world, m.
        orientation: of its base link, xyzw.
        velocity: of its base, linear (m/s), then angular (rad/s).
        joints: values by name, rad or m.
        joint_velocities: by name, rad/s or m/s.
        color: RGBA 0..1; empty: as its model says.
    """

    name: str
    type: str
    loaded: LoadBody
    position: Vector
    orientation: Quaternion
    velocity: tuple[float, ...] = (0.0,) * 6
    joints: Mapping[str, float] = field(default_factory=dict)
    joint_velocities: Mapping[str, float] = field(default_factory=dict)
    color: tuple[float, ...] = ()

    @property
    def pose(self) -> Pose:
        """Position and orientation."""
        return self.position, self.orientation

    @property
    def fixed_base(self) -> bool:
        """Whether physics leave its base where it is."""
        return self.loaded.fixed_base

    @property
    def models(self) -> tuple[str, ...]:
        """Names of its attached files; the first is the URDF."""
        names = (asset.path.rpartition("/")[2] for asset in self.loaded.assets)
        return tuple(f"{asset.sha256}/{name}" for asset, name in zip(self.loaded.assets, names, strict=True))

    def joint(self, name: str) -> float:
        """The value of a joint, rad or m.

        Raises:
            NoSuchName: there is none of that name.
        """
        if name not in self.joints:
            raise NoSuchName(f"movable joint of {self.name}", name, self.joints)
        return self.joints[name]


@dataclass(frozen=True, slots=True)
class Attachment:
    """One body carried by another.

    Attributes:
        carrier: name of the body that carries.
        carrier_link: its link; "" is its base.
        body: name of the carried one.
        body_link: the link that is held; "" is its base.
        position: of the carried one's base in the carrier's link, m.
        orientation: of the same, xyzw.
    """

    carrier: str
    carrier_link: str
    body: str
    body_link: str
    position: Vector
    orientation: Quaternion


@dataclass(frozen=True, slots=True)
class World:
    """A world.

    Attributes:
        name: its name.
        open: whether it still is; a closed one is empty.
        mode: "DIRECT" or "GUI".
        sim_step: simulated steps of 1/240 s.
        gravity: m/s^2.
        realtime: whether it runs at the pace of the clock.
        robot: name of the robot that plans control, or "".
        life: which world of that name it is, from 1: a name can be taken again.
        bodies: by name, in the order of loading.
        attachments: by names of carrier and body.
    """

    name: str
    open: bool = True
    mode: str = "DIRECT"
    sim_step: int = 0
    gravity: Vector = (0.0, 0.0, 0.0)
    realtime: bool = False
    robot: str = ""
    lifetime: int = 1
    bodies: Mapping[str, Body] = field(default_factory=dict)
    attachments: Mapping[tuple[str, str], Attachment] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What people call it: its name, and which of that name it is if it isn't the first."""
        return title(self.name, self.lifetime)

    @property
    def seconds(self) -> float:
        """Simulated time, s."""
        return self.sim_step / STEPS_PER_SECOND

    def body(self, name: str) -> Body:
        """A body by name.

        Raises:
            NoSuchName: there is none.
        """
        if name not in self.bodies:
            raise NoSuchName("object", name, self.bodies)
        return self.bodies[name]

    def carrier(self, body: str) -> Attachment | None:
        """How a body is carried; None if it isn't."""
        return next((held for held in self.attachments.values() if held.body == body), None)

    def carried(self, carrier: str) -> list[Attachment]:
        """What a body carries itself."""
        return [held for held in self.attachments.values() if held.carrier == carrier]


@dataclass(frozen=True, slots=True)
class State:
    """Everything after a step.

    Attributes:
        step: the step.
        worlds: by name, in the order of their opening; those that were closed are empty.
        doubt: in words, why this may not be all that is true: records were lost that could have changed it; else empty.
        assets: the files that are attached to the recording.
    """

    step: int
    worlds: Mapping[str, World]
    doubt: str = ""
    assets: Assets | None = field(default=None, repr=False, compare=False)

    def world(self, name: str | None = None) -> World:
        """A world by name; without one, the open one that was opened last.

        Raises:
            NoSuchName: there is none.
        """
        opened = [world for world in self.worlds.values() if world.open]
        if name is None and opened:
            return opened[-1]
        if name is None:
            raise NoSuchName("open world", "", self.worlds, self._none_open())
        if name not in self.worlds:
            raise NoSuchName("world", name, self.worlds)
        return self.worlds[name]

    def body(self, name: str, world: str | None = None) -> Body:
        """A body by name, of one world, or of the one that was opened last of those that have it.

        Raises:
            NoSuchName: there is none.
        """
        worlds = [self.world(world)] if world is not None else list(self.worlds.values())
        for candidate in reversed(worlds):
            if name in candidate.bodies:
                return candidate.bodies[name]
        raise self.no_body(name, worlds)

    def no_body(self, name: str, worlds: Iterable[World]) -> NoSuchName:
        """What to say where a body isn't in any of some worlds.

        Args:
            name: of the body.
            worlds: those of this state in which it was looked for.
        """
        opened = [world for world in worlds if world.open]
        known = [body for world in opened for body in world.bodies]
        others = [world.name for world in self.worlds.values() if world not in opened and name in world.bodies]
        if opened and others:
            here, there = (", ".join(told) for told in ([world.name for world in opened], others))
            return NoSuchName("object", name, known, f"it is in {there}, not in {here}; --world, or world=, names one")
        return NoSuchName("object", name, known, "" if opened else self._none_open())

    def _none_open(self) -> str:
        told = ", ".join(f"{world.title} has ended" for world in self.worlds.values())
        return f"no world is open after step {self.step}" + (f" ({told}); take an earlier one" if told else "")

    def urdf(self, body: Body) -> Urdf:
        """The model of a body, from the recording.

        Raises:
            NoSuchName: the recording doesn't have it.
        """
        if self.assets is None or not body.models:
            raise NoSuchName("attached model of", body.name, ())
        return self.assets.urdf(body.models[0])

    def link_pose(self, body: Body, link: str = "") -> Pose:
        """Pose of a link in the world.

        Args:
            body: one of this state.
            link: its name; "" is the base.

        Returns:
            Position (m) and orientation (xyzw).

        Raises:
            NoSuchName: there is no such link, or no model of the body.
        """
        if not link:
            return body.pose
        from recorder import geometry  # noqa: PLC0415  these need numpy, which most questions don't
        from recorder.geometry.joints import UrdfError  # noqa: PLC0415

        model = self.urdf(body)
        try:
            return geometry.multiply(body.pose, model.forward_kinematics(body.joints, link))
        except UrdfError:
            raise NoSuchName(f"link of {body.name}", link, model.links) from None
