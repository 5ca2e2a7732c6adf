"""Simulation clones: copies of a world in physics clients of their own, where things may be tried.

Whatever happens in a clone, the world has the same bits afterwards. A clone is made of the same models and is brought
to the world's state whenever somebody asks; bodies that have not changed cost a comparison.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeVar, cast

from pycram.physics.engine import Engine
from pycram.reasoning.collision.boxes import Boxes
from pycram.world.snapshot import Snapshot, take_snapshot
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Hashable, Iterable, Mapping

    from pycram.physics.body import Body
    from pycram.world.attachment import Attachment
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

T = TypeVar("T")

_MAX_CACHED: Final = 8  # values of a copy
_OUT_OF_THE_WAY: Final = ((0.0, 0.0, -1000.0), (0.0, 0.0, 0.0, 1.0))


@dataclass(slots=True)
class _Copy:
    original: Body
    body: Body
    state: Snapshot | None
    cache: dict[Hashable, tuple[Snapshot, object]] = field(default_factory=dict)


class SimulationClone:
    """A copy of some of a world's objects.

    Use it with the world's lock held.

    Args:
        world: the world.
        solid: its bodies collide; else they pass through each other, which costs less.
    """

    def __init__(self, world: BulletWorld, *, solid: bool) -> None:
        self.world = weakref.proxy(world)
        self._solid = solid
        self.engine = Engine()
        self._copies: dict[str, _Copy] = {}
        self._gravity: tuple[float, float, float] | None = None
        self._held: list[tuple[int, Body, str, Body, bool]] = []

    def sync(self, bodies: Iterable[Object] | None = None, *, holding: bool = False) -> Mapping[str, Body]:
        """Bring the copies to the world's state.

        Args:
            bodies: the objects that are wanted; others are put out of the way. All by default.
            holding: attachments among them hold when the clone is stepped.

        Returns:
            The engine's bodies of the wanted objects, by name.
        """
        wanted = {body.name: body for body in (self.world.objects if bodies is None else bodies)}
        self._release()
        if self._gravity != self.world.gravity:
            self.engine.set_gravity(self.world.gravity)
            self._gravity = self.world.gravity
        self._put_away(wanted)
        copies = {name: self._copy(body) for name, body in wanted.items()}
        if self._solid:  # contacts of earlier queries would change the last bits of the answer
            for body in wanted.values():
                self.engine.reset_collision_filter(copies[body.name], fixed=body.fixed, robot=body.is_robot)
        if holding:
            for body in wanted.values():
                for held in body.carried:
                    if held.body.name in copies:
                        self._hold(held, copies)
        return copies

    def _put_away(self, wanted: Container[str]) -> None:
        """Remove copies of what is no longer in the world, and put those out of the way that aren't wanted now."""
        living = {body.name: body for body in self.world.objects}
        for name, copy in list(self._copies.items()):
            if name not in living or living[name].handle is not copy.original:
                self.engine.remove(copy.body)
                del self._copies[name]
            elif name not in wanted and copy.state is not None:
                self.engine.set_pose(copy.body, _OUT_OF_THE_WAY)
                copy.state = None

    def _hold(self, held: Attachment, copies: Mapping[str, Body]) -> None:
        carrier, body = copies[held.carrier.name], copies[held.body.name]
        pose = geometry.multiply(
            geometry.invert(self.engine.link_pose(carrier, held.carrier_link)),
            self.engine.link_pose(body, held.body_link),
        )
        constraint = self.engine.fix(carrier, held.carrier_link, body, held.body_link, pose)
        robot = held.carrier.is_robot
        self.engine.pass_through(carrier, held.carrier_link, body, robot=robot, enable=True)
        self._held.append((constraint, carrier, held.carrier_link, body, robot))

    def _release(self) -> None:
        for constraint, carrier, link, body, robot in self._held:
            self.engine.unfix(constraint)
            self.engine.pass_through(carrier, link, body, robot=robot, enable=False)
        self._held.clear()

    def _copy(self, body: Object) -> Body:
        now = take_snapshot(body)
        copy = self._copies.get(body.name)
        if copy is None:
            loading = body.model.loading
            loaded = self.engine.load(body.model.path, now.pose, fixed=body.fixed, robot=body.is_robot, loading=loading)
            copy = self._copies[body.name] = _Copy(body.handle, loaded, None)
            if not self._solid:
                self.engine.ghost(loaded)
        if copy.state != now:
            self.engine.set_pose(copy.body, now.pose)
            if any(now.velocity) and not body.fixed:
                self.engine.set_velocity(copy.body, now.velocity)
            if now.positions and (copy.state is None or copy.state.positions != now.positions):
                # what isn't solid is never stepped
                put = self.engine.set_joints if self._solid else self.engine.pose_joints
                put(copy.body, dict(zip(body.joints, now.positions, strict=True)))
            copy.state = now
        return copy.body

    def boxes(self, body: Object) -> Boxes:
        """Return the boxes around an object's pieces, as it was last synced and not invalidated since."""
        return self.cached(body, "boxes", lambda copy: Boxes.around(self.engine, copy, body))

    def cached(self, body: Object, key: Hashable, compute: Callable[[Body], T]) -> T:
        """Return what was computed of an object as it was last synced; it is computed again when it has moved since.

        Args:
            body: one of the objects that were wanted, and not invalidated since.
            key: identifies the value.
            compute: makes it of the engine's copy.
        """
        copy = self._copies[body.name]
        if copy.state is None:
            raise AssertionError(f"{body.name} isn't as it was synced")
        state, value = copy.cache.get(key, (None, None))
        if state != copy.state:
            if len(copy.cache) >= _MAX_CACHED:
                copy.cache.clear()
            value = compute(copy.body)
            copy.cache[key] = copy.state, value
        return cast("T", value)

    def invalidate(self, *names: str) -> None:
        """Mark copies that are no longer as they were synced: the next sync puts them back.

        Args:
            names: of the objects; all by default.
        """
        for name in names or list(self._copies):
            if name in self._copies:
                self._copies[name].state = None

    def close(self) -> None:
        """End its physics client."""
        self.engine.close()


_clones: weakref.WeakKeyDictionary[BulletWorld, dict[str, SimulationClone]] = weakref.WeakKeyDictionary()
_registry = threading.Lock()


def clone_of(world: BulletWorld, purpose: str) -> SimulationClone:
    """Return the world's clone for a purpose, made at its first use and ended with the world.

    Args:
        world: the world; its lock is held.
        purpose: "reach", whose bodies aren't solid; "physics" and "physics with robots", which are stepped.
    """
    with _registry:
        clones = _clones.setdefault(world, {})
    if purpose not in clones:
        clone = clones[purpose] = SimulationClone(world, solid=purpose != "reach")
        world.at_exit(clone.close)
    return clones[purpose]
