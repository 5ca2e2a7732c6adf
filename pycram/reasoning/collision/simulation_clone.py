"""Simulation clones: copies of a world in other physics clients, for experiments that don't change the world.

In a :class:`PosingClone`, bodies pass through each other, and are set to poses and postures; single links of furniture
are loaded, because loading takes time. In a :class:`PhysicsClone`, bodies collide, and time is simulated; furniture is
loaded as rigid parts, because each link makes the engine's steps slower. Each query first updates its clone.
"""

from __future__ import annotations

import threading
import weakref
import xml.etree.ElementTree as ET
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy as copied
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeAlias, TypeVar, cast, overload

from pycram.models import store
from pycram.models.store import stored_tree
from pycram.physics.body import LoadedBody, Snapshot
from pycram.physics.engine import Engine
from pycram.reasoning.collision.boxes import Boxes, concatenate, overlaps
from pycram.world.attachment import BodyAttachment
from pycram.world.transaction import take_snapshot
from recorder import geometry
from recorder.geometry import Pose

if TYPE_CHECKING:
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

    Part: TypeAlias = tuple[Object, str]  # an object and the name of its link; "" for the whole object


T = TypeVar("T")

_MAX_CACHED: Final = 8  # maximum number of cached values of an object
_OUT_OF_THE_WAY: Final = ((0.0, 0.0, -1000.0), (0.0, 0.0, 0.0, 1.0))


@dataclass(slots=True)
class _Copy:
    original: LoadedBody  # the object's body in the world, which identifies the object, because ids are reused
    body: LoadedBody  # the body in the clone
    state: Snapshot | None = None  # the object's state when the copy was updated; None if the copy was changed


class SimulationClone:
    """Copies of a world's objects or of their parts in a physics client; callers hold the world's lock."""

    def __init__(self, world: BulletWorld) -> None:
        self.world = weakref.proxy(world)
        self._engine: Engine | None = None
        self._copies: dict[tuple[str, str], _Copy] = {}  # copies by object and link; "" for the whole object
        self._values: weakref.WeakKeyDictionary[Object, dict[Hashable, tuple[Snapshot, object]]]
        self._values = weakref.WeakKeyDictionary()

    @property
    def engine(self) -> Engine:
        """The physics client, which starts at its first use."""
        if self._engine is None:
            self._engine = Engine()
        return self._engine

    def _forget_removed(self) -> None:
        living = {body.name: body.handle for body in self.world.objects}
        for key, copy in list(self._copies.items()):
            if living.get(key[0]) is not copy.original:
                self.engine.remove(copy.body)
                del self._copies[key]

    def _load(self, body: Object, link: str, path: Path) -> _Copy:
        """Load a copy of an object from a model; with ``link``, a copy of a part whose frame is the link's frame."""
        robot = body.is_robot and not link
        loaded = self.engine.load(path, geometry.IDENTITY, fixed=body.fixed, robot=robot, loading=body.model.loading)
        copy = self._copies[body.name, link] = _Copy(body.handle, loaded)
        return copy

    def invalidate(self, *names: str) -> None:
        """Mark the copies of objects, or of all objects, as changed; each copy is updated before its next use."""
        for (name, _), copy in self._copies.items():
            if not names or name in names:
                copy.state = None

    def cached(self, body: Object, key: Hashable, compute: Callable[[], T]) -> T:
        """Return the value that ``compute`` returns for an object's state, from a cache until the object moves."""
        now = self.state(body)
        values = self._values.setdefault(body, {})
        state, value = values.get(key, (None, None))
        if state != now:
            if len(values) >= _MAX_CACHED:
                values.clear()
            value = compute()
            values[key] = now, value
        return cast("T", value)

    def state(self, body: Object) -> Snapshot:
        """Return the state of an object in the world."""
        return take_snapshot(body)

    def close(self) -> None:
        """End the physics client."""
        if self._engine is not None:
            self._engine.close()


class PosingClone(SimulationClone):
    """A clone whose bodies pass through each other, for closest points at other poses and postures."""

    def __init__(self, world: BulletWorld) -> None:
        super().__init__(world)
        self._states: dict[str, Snapshot] = {}

    def sync(self) -> None:
        """Read the world's state; each body is updated at its next use."""
        self._forget_removed()
        self._states = {body.name: take_snapshot(body) for body in self.world.objects}

    def body(self, name: str) -> LoadedBody:
        """Return the copy of an object. The copy has the object's state, unless the caller has moved the copy."""
        copy = self._copies.get((name, ""))
        if copy is not None and copy.state is self._states[name]:  # a query uses a body many times
            return copy.body
        body: Object = self.world.get_object(name)
        if copy is None:
            copy = self._load(body, "", body.model.path)
            self.engine.ghost(copy.body)
        now = self._states[name]
        if copy.state is None or copy.state.pose != now.pose:
            self.engine.set_pose(copy.body, now.pose)
        if now.positions and (copy.state is None or copy.state.positions != now.positions):
            self.engine.pose_joints(copy.body, dict(zip(body.joints, now.positions, strict=True)))
        copy.state = now
        return copy.body

    def state(self, body: Object) -> Snapshot:
        """Return the state of an object in the world at the latest :meth:`sync`."""
        return self._states[body.name]

    def link(self, body: Object, link: str) -> LoadedBody:
        """Return a copy of one link of an object at its state in the world; the link must have collision shapes."""
        copy = self._copies.get((body.name, link))
        if copy is None:
            copy = self._load(body, link, single_link(body.model.path, link))
            self.engine.ghost(copy.body)
        now = self._states[body.name]
        if copy.state != now:
            self.engine.set_pose(copy.body, body.world.engine.link_pose(body.handle, link))
            copy.state = now
        return copy.body

    def boxes(self, body: Object) -> Boxes:
        """Return the boxes around an object's pieces in the world."""
        return self.cached(body, "boxes", lambda: Boxes.around(body))

    def all_boxes(self, bodies: Iterable[Object]) -> tuple[Boxes, Sequence[Object]]:
        """Return the boxes around the pieces of objects in the world, and the owner of each box."""
        parts = [(body, self.boxes(body)) for body in bodies]
        return concatenate([boxes for _, boxes in parts]), [body for body, boxes in parts for _ in boxes.links]

    def overlapping(self, boxes: Boxes, bodies: Iterable[Object]) -> dict[Part, LoadedBody]:
        """Return copies of the parts that overlap some boxes: links of furniture, and other objects as a whole."""
        every, owners = self.all_boxes(bodies)
        *_, found = overlaps(boxes.centers[None], boxes.axes[None], boxes.half_extents, every)
        near = [(owners[number], every.links[number]) for number in sorted(set(found.tolist()))]
        parts = dict.fromkeys((body, link if body.is_environment else "") for body, link in near)
        return {(body, link): self.link(body, link) if link else self.body(body.name) for body, link in parts}


class PlacedPart(NamedTuple):
    """A rigid part of furniture and its body in a clone."""

    part: RigidPart
    body: LoadedBody


class PhysicsClone(SimulationClone):
    """A clone in which bodies collide and time is simulated."""

    def __init__(self, world: BulletWorld) -> None:
        super().__init__(world)
        self._gravity: tuple[float, float, float] | None = None
        self._held: list[tuple[int, LoadedBody, str, LoadedBody, bool]] = []

    def sync(self, bodies: Iterable[Object]) -> tuple[dict[str, LoadedBody], dict[str, list[PlacedPart]]]:
        """Update the clone to the present state of some objects and their attachments; move the other copies away.

        Furniture without attached objects is divided into rigid parts, which take less time to simulate. The result has
        the bodies of undivided objects, and the parts of divided objects, both by object name.
        """
        wanted = list(bodies)
        for constraint, carrier, link, carried, robot in self._held:
            self.engine.unfix(constraint)
            self.engine.pass_through(carrier, link, carried, robot=robot, enable=False)
        self._held.clear()
        if self._gravity != self.world.gravity:
            self.engine.set_gravity(self.world.gravity)
            self._gravity = self.world.gravity
        self._forget_removed()
        parts_of = {body.name: divided(body.model.path) for body in wanted if _divides(body)}
        keys = {(body.name, "") for body in wanted if body.name not in parts_of}
        keys |= {(name, str(part.path)) for name, each in parts_of.items() for part in each}
        for key, copy in self._copies.items():
            if key not in keys and copy.state is not None:
                self.engine.set_pose(copy.body, _OUT_OF_THE_WAY)
                copy.state = None
        whole: dict[str, LoadedBody] = {}
        placed: dict[str, list[PlacedPart]] = {}
        for body in wanted:
            if body.name in parts_of:
                placed[body.name] = self._parts(body, parts_of[body.name])
            else:
                whole[body.name] = self._whole(body)
        for body in wanted:
            for held in body.carried:
                if held.body.name in whole:
                    self._hold(held, whole)
        return whole, placed

    def _whole(self, body: Object) -> LoadedBody:
        now, copy = take_snapshot(body), self._copies.get((body.name, ""))
        if copy is None:
            copy = self._load(body, "", body.model.path)
        if copy.state != now:
            self.engine.set_pose(copy.body, now.pose)
            if any(now.velocity) and not body.fixed:
                self.engine.set_velocity(copy.body, now.velocity)
            if now.positions and (copy.state is None or copy.state.positions != now.positions):
                self.engine.set_joints(copy.body, dict(zip(body.joints, now.positions, strict=True)))
            copy.state = now
        self._forget_contacts(copy.body, body)
        return copy.body

    def _parts(self, body: Object, divided: Sequence[RigidPart]) -> list[PlacedPart]:
        now, found = take_snapshot(body), []
        for part in divided:
            copy = self._copies.get((body.name, str(part.path))) or self._load(body, str(part.path), part.path)
            if copy.state != now:
                self.engine.set_pose(copy.body, body.world.engine.link_pose(body.handle, part.frame))
                copy.state = now
            self._forget_contacts(copy.body, body)
            found.append(PlacedPart(part, copy.body))
        return found

    def _forget_contacts(self, copy: LoadedBody, body: Object) -> None:
        """Forget the contacts of earlier queries, which would affect the last bits of results."""
        self.engine.reset_collision_filter(copy, fixed=body.fixed, robot=body.is_robot)

    def _hold(self, held: BodyAttachment, copies: Mapping[str, LoadedBody]) -> None:
        carrier, body = copies[held.carrier.name], copies[held.body.name]
        pose = geometry.multiply(
            geometry.invert(self.engine.link_pose(carrier, held.carrier_link)),
            self.engine.link_pose(body, held.body_link),
        )
        constraint = self.engine.fix(carrier, held.carrier_link, body, held.body_link, pose)
        robot = held.carrier.is_robot
        self.engine.pass_through(carrier, held.carrier_link, body, robot=robot, enable=True)
        self._held.append((constraint, carrier, held.carrier_link, body, robot))


_clones: weakref.WeakKeyDictionary[BulletWorld, dict[str, SimulationClone]] = weakref.WeakKeyDictionary()
_registry = threading.Lock()


@overload
def clone_of(world: BulletWorld, purpose: Literal["reach"]) -> PosingClone: ...


@overload
def clone_of(world: BulletWorld, purpose: Literal["physics", "physics with robots"]) -> PhysicsClone: ...


def clone_of(world: BulletWorld, purpose: str) -> SimulationClone:
    """Return a world's clone for a purpose. The clone starts with its first use, and ends with the world.

    ``purpose`` is "reach" for postures, and "physics" or "physics with robots" for simulated time.
    """
    with _registry:
        clones = _clones.setdefault(world, {})
    if purpose not in clones:
        clone = clones[purpose] = PosingClone(world) if purpose == "reach" else PhysicsClone(world)
        world.at_exit(clone.close)
    return clones[purpose]


_INERTIA: Final = {"ixx": "1", "iyy": "1", "izz": "1", "ixy": "0", "ixz": "0", "iyz": "0"}
_CACHED_MODELS: Final = 128
_CACHED_LINKS: Final = 4096


def _divides(body: Object) -> bool:
    """Return whether an object can be simulated as rigid parts, because its base is fixed and its joints are held."""
    return body.is_environment and not body.carried and set(body.urdf.movable) == body.handle.joints.keys()


@dataclass(frozen=True, slots=True)
class RigidPart:
    """Links that are connected by fixed joints, merged into one link."""

    frame: str  # name of the link whose frame is the frame of the part
    links: tuple[str, ...]  # names of the merged links with collision shapes
    path: Path  # canonical URDF of the part


@lru_cache(maxsize=_CACHED_MODELS)
def divided(path: Path) -> tuple[RigidPart, ...]:
    """Return the rigid parts of a canonical URDF that have collision shapes.

    Links with different friction or stiffness are different parts, because a link has only one friction.
    """
    elements = {link.get("name", ""): link for link in store.document(path).findall("link")}
    urdf = stored_tree(path)
    frames: dict[str, str] = {}
    parts: dict[tuple[str, bytes], list[str]] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        frames[link] = frame = link if joint is None or joint.type != "fixed" else frames[joint.parent]
        element = elements[link]
        if element.find("collision") is not None:
            contact = b"".join(ET.tostring(each) for each in element.findall("contact"))
            parts.setdefault((frame, contact), []).append(link)
    poses = urdf.link_poses({})
    found = []
    for (frame, _), links in parts.items():
        placed = [(elements[link], geometry.multiply(geometry.invert(poses[frame]), poses[link])) for link in links]
        found.append(RigidPart(frame, tuple(links), _write(frame, placed)))
    return tuple(found)


@lru_cache(maxsize=_CACHED_LINKS)
def single_link(path: Path, link: str) -> Path:
    """Return the URDF of a model that consists of one link of a canonical URDF."""
    elements = store.document(path).findall("link")
    return _write(link, [(element, geometry.IDENTITY) for element in elements if element.get("name") == link])


def _write(name: str, links: Iterable[tuple[ET.Element, Pose]]) -> Path:
    """Store a model of one link with the collision shapes of links of equal friction, at poses in the new link."""
    root = ET.Element("robot", name=name)
    merged = ET.SubElement(root, "link", name=name)
    inertial = ET.SubElement(merged, "inertial")  # the inertia doesn't matter, because the base of a part is fixed
    ET.SubElement(inertial, "mass", value="1")
    ET.SubElement(inertial, "inertia", attrib=_INERTIA)
    for link, pose in links:
        if not merged.findall("contact"):
            merged.extend(link.findall("contact"))
        merged.extend(_moved(collision, pose) for collision in link.findall("collision"))
    return store.write_urdf(f"{name}.urdf", ET.tostring(root))[0]


def _moved(collision: ET.Element, pose: Pose) -> ET.Element:
    """Return a <collision> element in another frame; ``pose`` is the pose of its link in that frame."""
    if pose == geometry.IDENTITY:
        return collision
    moved = copied(collision)
    origin = moved.find("origin")
    xyz, rpy = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    if origin is not None:
        moved.remove(origin)
    x, y, z = map(float, xyz.split())
    at, turn = geometry.multiply(pose, ((x, y, z), geometry.from_rpy(*map(float, rpy.split()))))
    attributes = {"xyz": " ".join(map(repr, at)), "rpy": " ".join(map(repr, geometry.to_rpy(turn)))}
    moved.append(ET.Element("origin", attributes))
    return moved
