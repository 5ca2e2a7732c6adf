"""The state of worlds after a step as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

from recorder import html
from recorder.records import STEPS_PER_SECOND, Following, LoadBody
from recorder.records.fold import Attachment as Attachment  # noqa: PLC0414  none in optional parts of a state
from replay.errors import NoSuchName
from replay.file.assets import Assets
from replay.file.lifetimes import title

if TYPE_CHECKING:
    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.urdf import Urdf


@dataclass(frozen=True, slots=True, repr=False)
class Body:
    """A body of a world."""

    name: str
    type: str  # type of the body, such as "robot", "environment" or "milk".
    loaded: LoadBody  # the record of the loading: models, first pose, description of the robot
    position: Vector  # position of the base link in the world, m
    orientation: Quaternion  # orientation of the base link in the world, xyzw
    velocity: tuple[float, ...] = (0.0,) * 6  # velocity of the base link: linear (m/s), followed by angular (rad/s)
    joints: Mapping[str, float] = field(default_factory=dict)  # positions of joints by name, rad or m
    joint_velocities: Mapping[str, float] = field(default_factory=dict)  # velocities of joints by name, rad/s or m/s
    color: tuple[float, ...] = ()  # RGBA 0..1; empty if the model determines the colours

    def __repr__(self) -> str:
        return f"<Body {self.name} ({self.type}) at {html.vector(self.position)}>"

    @property
    def pose(self) -> Pose:
        """The pose of the base link in the world: xyz in m, and xyzw."""
        return self.position, self.orientation

    @property
    def fixed_base(self) -> bool:
        """Whether the base is fixed."""
        return self.loaded.fixed_base

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the files for the body that the recording contains. The first file is the URDF."""
        return tuple(f"{asset.sha256}/{asset.path.rpartition('/')[2]}" for asset in self.loaded.assets)

    def joint(self, name: str) -> float:
        """Return the position of a joint in rad or m.

        Raises:
            NoSuchName: The body has no movable joint with this name.
        """
        if name not in self.joints:
            raise NoSuchName(f"movable joint of {self.name}", name, self.joints)
        return self.joints[name]


@dataclass(frozen=True, slots=True)
class RecordedBelief:
    """A robot's belief about the pose of an object (:mod:`recorder.records.beliefs`)."""

    robot: str
    object: str
    position: Vector  # position of the object's base in the world, m; held objects have the true position
    orientation: Quaternion  # orientation of the object's base, xyzw
    source: str  # "seen", "told" (read from the world's state), "held", or "placed" (released by the robot)
    sim_step: int  # number of simulated steps of 1/240 s at which the robot learned the belief
    step: int  # step of the look, grasp or release that set the belief; -1 before the recording

    @property
    def pose(self) -> Pose:
        """Position and orientation."""
        return self.position, self.orientation


@dataclass(frozen=True, slots=True, repr=False)
class World:
    """The state of a world."""

    name: str
    open: bool = True  # a world that was closed is empty
    mode: str = "DIRECT"  # "DIRECT", or "GUI" with a window
    sim_step: int = 0  # number of simulated steps of 1/240 s
    gravity: Vector = (0.0, 0.0, 0.0)  # m/s^2
    realtime: bool = False  # whether the world keeps pace with the wall clock
    robot: str = ""  # name of the world's robot
    lifetime: int = 1  # number among the worlds with the same name, from 1
    bodies: Mapping[str, Body] = field(default_factory=dict)  # bodies by name, in the order of loading
    attachments: Mapping[tuple[str, str], Attachment] = field(default_factory=dict)  # attachments by carrier and body
    following: Mapping[int, Following] = field(default_factory=dict)  # trajectories that bodies follow, by number
    #: Beliefs by names of robot and object, the latest belief last.
    beliefs: Mapping[tuple[str, str], RecordedBelief] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<World {self._summary()}>"

    def _repr_html_(self) -> str:
        return html.page(self._summary(), self._table())

    def _summary(self) -> str:
        if not self.open:
            return f"{self.title}: closed"
        count = f"{len(self.bodies)} object{'' if len(self.bodies) == 1 else 's'}"
        return f"{self.title}: {count}, {self.seconds:.3f} s simulated{self.robot and f', robot {self.robot}'}"

    def _table(self) -> str:
        if not self.bodies:
            return ""
        rows = []
        for body in self.bodies.values():
            held = self.carrier(body.name)
            by = f"{held.carrier} {held.carrier_link}" if held is not None else ""
            rows.append((body.name, body.type, html.vector(body.position), html.vector(body.orientation), by))
        return html.table(("object", "type", "position, m", "orientation, xyzw", "held by"), rows)

    @property
    def title(self) -> str:
        """The world's name for users, as :func:`replay.file.lifetimes.title` makes it."""
        return title(self.name, self.lifetime)

    @property
    def seconds(self) -> float:
        """Simulated time, s."""
        return self.sim_step / STEPS_PER_SECOND

    def body(self, name: str) -> Body:
        """Return a body by name; raise NoSuchName if the world has no such body."""
        if name not in self.bodies:
            raise NoSuchName("object", name, self.bodies)
        return self.bodies[name]

    def carrier(self, body: str) -> Attachment | None:
        """Return the attachment of a body to its carrier; None if it has none."""
        return next((held for held in self.attachments.values() if held.body == body), None)

    def carried(self, carrier: str) -> list[Attachment]:
        """Return the attachments of the bodies that a body carries directly."""
        return [held for held in self.attachments.values() if held.carrier == carrier]

    def believed(self, what: str | None = None, robot: str | None = None) -> list[RecordedBelief]:
        """Return beliefs of robots, the latest belief first.

        Args:
            what: Name or type of objects; None for all objects.
            robot: Name of the robot; None for all robots.
        """
        types = {name: body.type for name, body in self.bodies.items()}
        return [
            belief
            for belief in reversed(list(self.beliefs.values()))
            if robot in (None, belief.robot) and what in (None, belief.object, types.get(belief.object, ""))
        ]


@dataclass(frozen=True, slots=True)
class Sampled:
    """A moment within a simulation, which has 30 samples in each simulated second."""

    step: int  # step of the simulation's record
    world: str
    start: float  # simulated time of the world before the simulation, s
    end: float  # simulated time of the world after the simulation, s
    asked: float  # the requested moment: simulated time, s
    #: Time in s of the last sample up to the moment; ``start`` if there is none. The recorder leaves out samples
    #: without visible motion.
    at: float


class MomentSource(Protocol):
    """The recording to which a state belongs."""

    def last_open(self, world: str | None) -> State:
        """Return the state after the last step with an open world, not later than this state's step."""

    def png(self, world: str) -> bytes | None:
        """Return a small PNG picture of a world, or None."""


@dataclass(frozen=True, slots=True, repr=False)
class State:
    """All worlds after a step, or at a moment within the next simulation."""

    step: int
    worlds: Mapping[str, World]  # worlds by name, in the order of their opening
    uncertainty: str = ""  # text about lost records that may have changed the state
    assets: Assets | None = field(default=None, repr=False, compare=False)  # the files that the recording contains
    sampled: Sampled | None = None  # the moment within a simulation; None for a state after a step
    source: MomentSource | None = field(default=None, repr=False, compare=False)  # the open recording

    def __repr__(self) -> str:
        worlds = "; ".join(world._summary() for world in self.worlds.values())  # noqa: SLF001  same module
        return f"<State {self._when()}: {worlds or 'no worlds'}>"

    def _repr_html_(self) -> str:
        parts = []
        for world in self.worlds.values():
            png = self.source.png(world.name) if self.source is not None and world.open else None
            parts += [world._repr_html_(), html.picture(png, world.title) if png is not None else ""]
        if self.source is not None and self.worlds and not any(world.open for world in self.worlds.values()):
            parts.append(self.source.last_open(None)._repr_html_())
        return html.page(f"State {self._when()}{self.uncertainty and f'; {self.uncertainty}'}", *parts)

    def _when(self) -> str:
        return f"after step {self.step}" if self.sampled is None else f"at {self.sampled.at:.3f} s"

    def world(self, name: str | None = None) -> World:
        """Return a world by name, by default the last opened world that is still open.

        If all worlds have ended, the result is the last world, as it was after the last step at which it was open.

        Raises:
            NoSuchName: There is no such world.
        """
        opened = [world for world in self.worlds.values() if world.open]
        if name is None and opened:
            return opened[-1]
        if name is None and self.worlds and self.source is not None:
            return self.source.last_open(None).world()
        if name is None:
            raise NoSuchName("open world", "", self.worlds, self._none_open())
        if name not in self.worlds:
            raise NoSuchName("world", name, self.worlds)
        return self.worlds[name]

    def body(self, name: str, world: str | None = None) -> Body:
        """Return a body by name. By default, the world is the last opened world with the body.

        If all worlds have ended, return the body as it was after the last step with an open world.

        Raises:
            NoSuchName: There is no such body.
        """
        worlds = [self.world(world)] if world is not None else list(self.worlds.values())
        for candidate in reversed(worlds):
            if name in candidate.bodies:
                return candidate.bodies[name]
        if self.source is not None and not any(each.open for each in self.worlds.values()):
            return replace(self.source.last_open(world), source=None).body(name, world)
        raise self.no_body(name, worlds)

    def no_body(self, name: str, worlds: Iterable[World]) -> NoSuchName:
        """Return the error for a body that none of the worlds contains."""
        opened = [world for world in worlds if world.open]
        known = [body for world in opened for body in world.bodies]
        elsewhere = [world.name for world in self.worlds.values() if world not in opened and name in world.bodies]
        if opened and elsewhere:
            here, there = (", ".join(names) for names in ([world.name for world in opened], elsewhere))
            return NoSuchName(
                "object", name, known, f"it is in {there}, not in {here}; choose a world with --world, or world="
            )
        return NoSuchName("object", name, known, "" if opened else self._none_open())

    def _none_open(self) -> str:
        ended = ", ".join(f"{world.title} has ended" for world in self.worlds.values())
        return f"no world is open after step {self.step}" + (f" ({ended}); take an earlier step" if ended else "")

    def urdf(self, body: Body) -> Urdf:
        """Return the model of a body from the recording; raise NoSuchName if the recording has no such model."""
        if self.assets is None or not body.models:
            raise NoSuchName("attached model of", body.name, ())
        return self.assets.urdf(body.models[0])

    def link_pose(self, body: Body, link: str = "") -> Pose:
        """Return the pose of a body's link in the world, m and xyzw. The link "" is the base.

        Raises:
            NoSuchName: The body has no such link, or the recording lacks the model.
        """
        if not link:
            return body.pose
        from recorder import geometry  # noqa: PLC0415  imported here: numpy, which most verbs don't need
        from recorder.urdf import UrdfError  # noqa: PLC0415

        model = self.urdf(body)
        try:
            return geometry.multiply(body.pose, model.forward_kinematics(body.joints, link))
        except UrdfError:
            raise NoSuchName(f"link of {body.name}", link, model.links) from None

    def link_poses(self, body: Body) -> dict[str, Pose]:
        """Return the poses of all links of a body in the world by name, m and xyzw.

        Raises:
            NoSuchName: The recording lacks the model.
        """
        from recorder import geometry  # noqa: PLC0415  imported here: numpy, which most verbs don't need

        poses = self.urdf(body).link_poses(body.joints).items()
        return {link: geometry.multiply(body.pose, pose) for link, pose in poses}


def turn(before: Sequence[float], after: Sequence[float]) -> float:
    """Return the angle between two orientations xyzw in rad."""
    if before == after:
        return 0.0
    from recorder import geometry  # noqa: PLC0415  needs numpy

    return geometry.angle(before, after)
