"""Joints of an object: checked positions, and movements together with attached and supported bodies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, JointLimitError
from pycram.world import carried
from recorder import records

if TYPE_CHECKING:
    from pycram.world.object import Object

_LIMIT_TOLERANCE: Final = 1e-6  # rad or m, against rounding errors of positions that were read before


def set_positions(body: Object, positions: Mapping[str, float]) -> None:
    """Put joints to positions (rad or m, by name); see :meth:`pycram.world.object.Object.set_joint_positions`."""
    if not isinstance(positions, Mapping):
        raise BadArgument("positions", positions, "values by joint name, such as {'torso_lift_joint': 0.2}")
    checked = {name: _checked(body, name, position) for name, position in positions.items()}
    command = records.MoveJoints(body=body.name, joints=list(checked), positions=list(checked.values()))
    engine = body.world.engine
    with body.world.transactions.begin(records.Mutation(move_joints=command)) as transaction:
        links = [] if body.is_robot else carried.moved_links(body.urdf, checked)
        supported = carried.supported_bodies(body, links) if links else {}
        before = {link: engine.link_pose(body.handle, link) for link in set(supported.values())}
        engine.set_joints(body.handle, checked)
        transaction.mark_modified(body)
        carried.move_supported(body, before, supported, transaction)
        carried.move_attached(body, transaction)
        if body.is_environment:
            transaction.fire(body.world.get_manipulation_event(), body)


def _checked(body: Object, name: str, position: float) -> float:
    lower, upper = body.joint_limits(name)
    checked = checks.number(f"joint {name}", position)
    if not lower - _LIMIT_TOLERANCE <= checked <= upper + _LIMIT_TOLERANCE:
        raise JointLimitError(body.name, name, checked, lower, upper)
    return checked
