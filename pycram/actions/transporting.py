"""Bringing an object somewhere."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import ActionDesignator, action
from pycram.actions.checks import place_for_an_object, portable
from pycram.actions.fetching import choices, prepare
from pycram.actions.hands import arms, held_by, holder
from pycram.actions.objects import candidates_of, object_of
from pycram.actions.performing import ActionFailed, perform
from pycram.actions.placing import check_target
from pycram.foundation.failures import NoPlace, PlanFailure

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.actions.containers import Access
    from pycram.world.object import Object


_TRIES: Final = 4  # that closing may fail


def _prepare(object: Any, target: Any, close: bool = True) -> Iterator[None]:  # noqa: A002  the slot's name
    """See whether there is a place for the object, before it is looked for and taken; close what was opened for it."""
    arms()
    check_target(candidates_of(object)[0], target)
    opened = prepare(object)
    try:
        yield
    except PlanFailure:
        _close(opened if close else ())
        raise
    _close(opened if close else ())


def _close(opened: Sequence[Access]) -> None:
    """Close what was opened; what can't be closed from anywhere stays open."""
    for access in opened:
        with suppress(PlanFailure):
            perform(ActionDesignator(type="closing", container=access.name, budget=_TRIES))


@action(
    "transporting",
    choices=choices,
    prepare=_prepare,
    checked={"object": portable, "target": place_for_an_object},
)
def transporting(
    object: Any,  # noqa: A002  the slot's name
    target: Any,
    arm: str | None = None,
    grasp: str | None = None,
    place: Any = None,
    clear: bool = False,
    close: bool = True,  # noqa: ARG001  done in the end
) -> Any:
    """Fetches an object and delivers it; the drawer or door that was opened for it is closed again.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: Where it is to be put: a LocationDesignator, the name of a surface, or [x, y, z] in m, world frame.
        arm: Name of the arm; by default each is tried that is free.
        grasp: The side from which the gripper comes: "front", "top", "left" or "right"; by default the freest.
        place: Where the robot stands to take it, a LocationDesignator; by default places from which it reaches it.
        clear: Whether to clear away at once what is in the way of it.
        close: Whether what is opened for it is closed in the end, where that can be done.
    """
    body = object_of(object)
    perform(ActionDesignator(type="fetching", object=body, arm=arm, grasp=grasp, place=place, clear=clear))
    deliver = ActionDesignator(type="delivering", object=body, target=target)
    try:
        return perform(deliver)
    except (NoPlace, ActionFailed) as failure:  # for the arm that holds it
        hand_over(body, failure)
        return perform(deliver.copy())


def hand_over(body: Object, failure: PlanFailure) -> None:
    """Give what an arm holds to another one, which may get to where the first doesn't.

    Raises:
        PlanFailure: That failure, if there is no other arm that is free.
    """
    if holder(body) is None or not any(held_by(arm) is None for arm in arms()):
        raise failure
    perform(ActionDesignator(type="handing-over", object=body))
