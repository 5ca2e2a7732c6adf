"""Worlds that a plan acts in: where the viewer looks in each, and which of them is in front."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from recorder.records import Record
    from recorder.viewer.scene import Scene

_SETUP: Final = ("open_world", "load_body", "set_gravity", "set_realtime", "set_robot", "set_color")
_CLOSE: Final = "close_world"
_KEYFRAME: Final = "keyframe"


class ActiveWorlds:
    """The worlds that plans have acted in so far.

    Attributes:
        centres: their centres in m when plans began to act in them, by name.
        front: the first that is still open; "" before there is one.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._open: dict[str, None] = {}  # worlds that a plan acted in
        self.centres: dict[str, Vector] = {}
        self.front = ""

    def follow(self, record: Record) -> None:
        """Notes when a plan begins to act in a world, and when it closes it; the scene has shown the record."""
        world, action = record.world, _action(record)
        if world not in self.centres and action not in _SETUP:
            self.centres[world] = self._scene.centre(world)
        if world in self._open:
            if action != _CLOSE:
                return
            del self._open[world]
        elif _is_act(action):
            self._open[world] = None
        self.front = next(iter(self._open), self.front)

    def add_others(self) -> None:
        """Adds the worlds that no plan acted in."""
        for world in self._scene.bodies:
            self.centres.setdefault(world, self._scene.centre(world))


def acts(record: Record) -> bool:
    """Whether a plan acts in the record's world, beyond opening, filling and closing it."""
    return bool(record.world) and _is_act(_action(record))


def _is_act(action: str) -> bool:
    return action not in (*_SETUP, _CLOSE, _KEYFRAME)


def _action(record: Record) -> str:
    """What a record does to a world: a mutation's command; "" if it does nothing."""
    if type(record) is Mutation:  # isinstance takes five times as long where it is none
        return record.WhichOneof("command") or "change"  # of another version
    return _KEYFRAME if type(record) is Keyframe else ""
