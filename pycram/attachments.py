"""Attachments: which object carries which, and with what relative pose.

The carrier is the object whose ``attach`` was called. What it carries keeps its full pose relative to the carrier's
link whenever the carrier, its joints or the carrier's own carrier move; no simulation is needed. In simulation a fixed
constraint of the engine keeps it there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.failures import AttachmentError
from recorder import records

if TYPE_CHECKING:
    from pycram.engine import Pose
    from pycram.objects import Object


@dataclass(frozen=True, slots=True)
class Attachment:
    """One object carried by another.

    Attributes:
        carrier: the object that carries.
        carrier_link: its link, the base link if none was named.
        body: the carried object.
        body_link: the link by which it is held, its base link if none was named.
        pose: of the carried object's base in the carrier's link: position in m, orientation xyzw.
        constraint: the engine's id of the joint that holds it in simulation.
    """

    carrier: Object
    carrier_link: str
    body: Object
    body_link: str
    pose: Pose
    constraint: int

    def other(self, side: Object) -> Object:
        """The other one of the two."""
        return self.body if side is self.carrier else self.carrier

    def record(self) -> records.Attachment:
        """As records carry it."""
        return records.Attachment(
            carrier=self.carrier.name,
            carrier_link=self.carrier_link,
            body=self.body.name,
            body_link=self.body_link,
            position=self.pose[0],
            orientation=self.pose[1],
        )


def check(carrier: Object, body: Object) -> None:
    """Refuses attachments that make no sense.

    Args:
        carrier: the object that is to carry.
        body: the object that is to be carried.

    Raises:
        AttachmentError: they are the same, live in different worlds, the body is fixed or carried by another, or the
            carrier is itself carried by the body.
    """
    if carrier is body:
        raise AttachmentError(carrier.name, body.name, "an object can't carry itself")
    if carrier.world is not body.world:
        raise AttachmentError(carrier.name, body.name, f"{body.name} is in {body.world.name}, another world")
    if body.fixed:
        raise AttachmentError(carrier.name, body.name, f"{body.name} has a fixed base")
    if body.carrier is not None:
        raise AttachmentError(carrier.name, body.name, f"{body.carrier.name} carries it; detach it there first")
    above: Object | None = carrier
    while above is not None:
        if above is body:
            raise AttachmentError(carrier.name, body.name, f"{body.name} carries {carrier.name} already")
        above = above.carrier
