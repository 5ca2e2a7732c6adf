"""Contacts between bodies of live or recorded worlds, measured in a separate physics client."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from pycram.models.load import Model
from pycram.physics.body import ClosestPoint, LoadedBody
from pycram.physics.engine import Engine
from pycram.reasoning.queries.contact import MARGIN
from recorder.properties.expressions import RANGE, Touch, Truth
from recorder.records import LoadBody
from recorder.records.fold import FoldedBody, FoldedWorld


@dataclass(slots=True)
class _Copy:
    model: Model
    body: LoadedBody
    original: FoldedBody | None = None  # the body whose state was copied
    version: int = -1  # version of the state that was copied


@dataclass(slots=True)
class ContactClient:
    """Measures contacts; ``model_of`` returns the model of a loaded body in the world with a name."""

    model_of: Callable[[str, LoadBody], Model]
    _engine: Engine | None = None
    _copies: dict[tuple[str, str, str], _Copy] = field(default_factory=dict)  # copies by world, body and model
    _known: dict[object, tuple[object, list[ClosestPoint]]] = field(default_factory=dict)  # latest results by pair

    def touch(self, world: FoldedWorld, one: tuple[str, str], other: tuple[str, str]) -> Touch:
        """Return the nearest points of two bodies, or of a link of each body; "" stands for all links."""
        bodies = world.bodies[one[0]], world.bodies[other[0]]
        key, state = (world.name, one[0], other[0]), tuple((id(body), body.version) for body in bodies)
        if self._known.get(key, (None,))[0] != state:
            a, b = (self._placed(world, body) for body in reversed(bodies))  # one point is enough to carry the body
            self._known[key] = state, self._client().closest_points(a, b, RANGE)
        near = [
            point for point in self._known[key][1] if one[1] in ("", point.link_b) and other[1] in ("", point.link_a)
        ]
        return Touch(_truth(near), _truth(point for point in near if point.carries))

    def owner(self, world: FoldedWorld, link: str) -> str:
        """Return the body that has a link with this name; "" if no body has this link."""
        return next((name for name, body in world.bodies.items() if link in self._copy(world, body).body.links), "")

    def _client(self) -> Engine:
        if self._engine is None:
            self._engine = Engine()
        return self._engine

    def _copy(self, world: FoldedWorld, body: FoldedBody) -> _Copy:
        loaded = body.loaded
        key = world.name, loaded.body, loaded.assets[0].sha256 if loaded.assets else ""
        if key not in self._copies:
            model, engine = self.model_of(world.name, loaded), self._client()
            copy = engine.load(model.path, (body.position, body.orientation), fixed=True, loading=model.loading)
            engine.ghost(copy)
            self._copies[key] = _Copy(model, copy)
        return self._copies[key]

    def _placed(self, world: FoldedWorld, body: FoldedBody) -> LoadedBody:
        copy = self._copy(world, body)
        if (copy.original, copy.version) != (body, body.version):
            engine = self._client()
            engine.set_pose(copy.body, (body.position, body.orientation))
            joints = {name: value for name, value in body.joints.items() if name in copy.body.joints}
            if joints:
                engine.pose_joints(copy.body, joints)
            copy.original, copy.version = body, body.version
        return copy.body


def _truth(points: Iterable[ClosestPoint]) -> Truth:
    distance = min((point.distance for point in points), default=RANGE + MARGIN)
    return Truth(MARGIN - distance, distance <= MARGIN)
