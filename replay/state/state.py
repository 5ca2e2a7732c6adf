"""States of worlds after a step: plain data, without a physics engine. Each state has its own mappings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from recorder.records import STEPS_PER_SECOND
from replay.errors import NoSuchName
from replay.file.lifetimes import title

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.geometry.urdf import Urdf
    from recorder.records import Following, LoadBody
    from replay.file.assets import Assets


@dataclass(frozen=True, slots=True)
class Body:
    """A body.

    Attributes:
        name: its name.
        type: "robot", "environment", "milk", ...
        loaded: the record of its loading: models, initial pose, robot description.
        position: of its base link in the world, m.
        orientation: of its base link, xyzw.
        velocity: of its base, linear (m/s), then angular (rad/s).
        joints: values by name, rad or m.
        joint_velocities: by name, rad/s or m/s.
        color: RGBA 0..1; empty: that of its model.
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
        """Whether physics doesn't move its base."""
        return self.loaded.fixed_base

    @property
    def models(self) -> tuple[str, ...]:
        """Names of its attached files; the first is the URDF."""
        names = (asset.path.rpartition("/")[2] for asset in self.loaded.assets)
        return tuple(f"{asset.sha256}/{name}" for asset, name in zip(self.loaded.assets, names, strict=True))

    def joint(self, name: str) -> float:
        """Return the value of a joint, rad or m.

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
        body: name of the carried body.
        body_link: the link that is held; "" is its base.
        position: of the carried body's base in the carrier's link, m.
        orientation: of the same, xyzw.
    """

    carrier: str
    carrier_link: str
    body: str
    body_link: str
    position: Vector
    orientation: Quaternion


@dataclass(frozen=True, slots=True)
class Belief:
    """Where a robot believes an object to be; :mod:`recorder.records.beliefs` says what it is made of.

    Attributes:
        robot: name of the robot.
        object: name of the object.
        position: where, of its base in the world, m; of what the robot holds, where the hand has it.
        orientation: of the same, xyzw.
        source: "seen"; "told", by the world's state; "held"; "placed", where the robot let go of it.
        sim_step: simulated steps of 1/240 s when that was learned.
        step: the record that taught it: a look, or what it took or put down; -1: it is older than the recording.
    """

    robot: str
    object: str
    position: Vector
    orientation: Quaternion
    source: str
    sim_step: int
    step: int

    @property
    def pose(self) -> Pose:
        """Position and orientation."""
        return self.position, self.orientation


@dataclass(frozen=True, slots=True)
class World:
    """A world.

    Attributes:
        name: its name.
        open: whether it is open; a closed one is empty.
        mode: "DIRECT" or "GUI".
        sim_step: simulated steps of 1/240 s.
        gravity: m/s^2.
        realtime: whether it is simulated in real time.
        robot: name of the robot that plans control, or "".
        lifetime: number of its lifetime, from 1: a name can be taken again.
        bodies: by name, in the order of loading.
        attachments: by names of carrier and body.
        following: trajectories that bodies follow, by number.
        beliefs: what robots believe of objects, by names of robot and object; what was learned last comes last.
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
    following: Mapping[int, Following] = field(default_factory=dict)
    beliefs: Mapping[tuple[str, str], Belief] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Its name for people; see :func:`replay.file.lifetimes.title`."""
        return title(self.name, self.lifetime)

    @property
    def seconds(self) -> float:
        """Simulated time, s."""
        return self.sim_step / STEPS_PER_SECOND

    def body(self, name: str) -> Body:
        """Return a body by name.

        Raises:
            NoSuchName: there is none.
        """
        if name not in self.bodies:
            raise NoSuchName("object", name, self.bodies)
        return self.bodies[name]

    def carrier(self, body: str) -> Attachment | None:
        """Return how a body is carried; None if it isn't."""
        return next((held for held in self.attachments.values() if held.body == body), None)

    def believed(self, what: str | None = None, robot: str | None = None) -> list[Belief]:
        """Return what robots believe, what was learned last first.

        Args:
            what: name or type of objects; None for all.
            robot: name of the robot; None for all.
        """
        return [
            belief
            for belief in reversed(list(self.beliefs.values()))
            if robot in (None, belief.robot) and what in (None, belief.object, self._type(belief.object))
        ]

    def _type(self, body: str) -> str:
        return self.bodies[body].type if body in self.bodies else ""

    def carried(self, carrier: str) -> list[Attachment]:
        """Return what a body carries itself."""
        return [held for held in self.attachments.values() if held.carrier == carrier]


@dataclass(frozen=True, slots=True)
class Sampled:
    """A moment within a stretch of simulation, of which there are samples, 30 a simulated second.

    Attributes:
        step: the record of the stretch.
        world: name of its world.
        start: the world's clock before the stretch, s of simulated time.
        end: its clock after it, s.
        asked: the moment that was asked for, s.
        at: the last sample until then, s; ``start`` if there is none. Nothing moved visibly in those that are missing.
    """

    step: int
    world: str
    start: float
    end: float
    asked: float
    at: float


@dataclass(frozen=True, slots=True)
class State:
    """Everything after a step, or at a moment within the stretch of simulation that follows it.

    Attributes:
        step: the step.
        worlds: by name, in the order of their opening; those that were closed are empty.
        uncertainty: which lost records could have changed it, in words; else empty.
        assets: the files that are attached to the recording.
        sampled: of a moment within a stretch of simulation: how it is known; None after a step.
    """

    step: int
    worlds: Mapping[str, World]
    uncertainty: str = ""
    assets: Assets | None = field(default=None, repr=False, compare=False)
    sampled: Sampled | None = None

    def world(self, name: str | None = None) -> World:
        """Return a world by name; without one, the open one that was opened last.

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
        """Return a body by name, of one world, or of the one that was opened last of those that have it.

        Raises:
            NoSuchName: there is none.
        """
        worlds = [self.world(world)] if world is not None else list(self.worlds.values())
        for candidate in reversed(worlds):
            if name in candidate.bodies:
                return candidate.bodies[name]
        raise self.no_body(name, worlds)

    def no_body(self, name: str, worlds: Iterable[World]) -> NoSuchName:
        """Return the error for a body that isn't in any of some worlds."""
        opened = [world for world in worlds if world.open]
        known = [body for world in opened for body in world.bodies]
        elsewhere = [world.name for world in self.worlds.values() if world not in opened and name in world.bodies]
        if opened and elsewhere:
            here, there = (", ".join(names) for names in ([world.name for world in opened], elsewhere))
            return NoSuchName(
                "object", name, known, f"it is in {there}, not in {here}; choose one with --world, or world="
            )
        return NoSuchName("object", name, known, "" if opened else self._none_open())

    def _none_open(self) -> str:
        ended = ", ".join(f"{world.title} has ended" for world in self.worlds.values())
        return f"no world is open after step {self.step}" + (f" ({ended}); take an earlier step" if ended else "")

    def urdf(self, body: Body) -> Urdf:
        """Return the model of a body, from the recording.

        Raises:
            NoSuchName: the recording doesn't have it.
        """
        if self.assets is None or not body.models:
            raise NoSuchName("attached model of", body.name, ())
        return self.assets.urdf(body.models[0])

    def link_pose(self, body: Body, link: str = "") -> Pose:
        """Return the pose of a body's link in the world, m and xyzw; "" is its base.

        Raises:
            NoSuchName: there is no such link, or no model of the body.
        """
        if not link:
            return body.pose
        from recorder import geometry  # noqa: PLC0415  these need numpy, which reading mostly doesn't
        from recorder.geometry.joints import UrdfError  # noqa: PLC0415

        model = self.urdf(body)
        try:
            return geometry.multiply(body.pose, model.forward_kinematics(body.joints, link))
        except UrdfError:
            raise NoSuchName(f"link of {body.name}", link, model.links) from None

    def link_poses(self, body: Body) -> dict[str, Pose]:
        """Return the poses of all links of a body in the world, m and xyzw, by name.

        Raises:
            NoSuchName: there is no model of the body.
        """
        from recorder import geometry  # noqa: PLC0415  needs numpy, which reading mostly doesn't

        poses = self.urdf(body).link_poses(body.joints).items()
        return {link: geometry.multiply(body.pose, pose) for link, pose in poses}


def turn(before: Sequence[float], after: Sequence[float]) -> float:
    """Return the angle between two orientations xyzw, rad."""
    if before == after:
        return 0.0
    from recorder import geometry  # noqa: PLC0415  needs numpy

    return geometry.angle(before, after)
