"""Errors: base classes, usage errors, and chains of errors.

Most errors are dataclasses with a template for the message (:func:`dataclass_error`), such as :class:`ReadOnly`. The
fields are parameters of the constructor, and are recorded in this order. If the parameters differ from the fields, an
error has its own ``__init__``, which calls ``super().__init__(message)``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NoReturn, TypeVar, cast, dataclass_transform

from recorder.errors import PortableError, nearest, suggestion
from recorder.records import escaped

__all__ = [
    "AssetError",
    "AttachmentError",
    "BadArgument",
    "ChangeRefused",
    "DisplayError",
    "FollowsTrajectory",
    "JointLimitError",
    "NoWorld",
    "ObjectsChanged",
    "PlanFailure",
    "PycramError",
    "ReadOnly",
    "UnknownName",
    "UsageError",
    "WorldClosed",
]

Given = TypeVar("Given")
ErrorType = TypeVar("ErrorType", bound=BaseException)


class PycramError(PortableError):
    """Base of all errors that PyCRAM defines."""

    _template: ClassVar[str] = ""  # message of a dataclass error, with field names in braces

    @property
    def data(self) -> Mapping[str, object]:
        """The values of the error's fields by name."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}

    def _complete(self) -> None:
        """Set the fields that depend on other fields."""

    def _message(self) -> str:
        """Return the message; overridden if a message needs more than the template."""
        return self._template.format_map(vars(self))


class PlanFailure(PycramError):
    """The world prevents an action; a plan may handle the failure."""


class UsageError(PycramError):
    """The program is wrong; plans must not handle the error."""


def kept_as(convert: Callable[[Given], object], **default: Given | None) -> Given:
    """Return a field of a dataclass error; ``convert`` (list, dict, ...) converts the value, but None stays None."""
    return cast("Given", field(**default, metadata={"convert": convert}))  # type: ignore[call-overload]  # ``default`` is the only keyword


def floats(values: Sequence[float]) -> list[float]:
    """Return a list of Python floats; ``values`` may be an array."""
    return [float(value) for value in values]


@dataclass_transform(eq_default=False, field_specifiers=(field, kept_as))
def dataclass_error(kind: type[ErrorType]) -> type[ErrorType]:
    """Make an error a dataclass; its template or its ``_message()`` makes the message.

    The attributes that mark a dataclass are deleted, so a dataclass that a plan derives from the error has only its own
    fields. Errors are equal only to themselves, and print like other exceptions.
    """
    dataclass(eq=False, repr=False, match_args=False)(kind)
    conversions = {each.name: each.metadata["convert"] for each in fields(cast("Any", kind)) if each.metadata}
    del kind.__dataclass_fields__, kind.__dataclass_params__  # type: ignore[attr-defined]  # the decorator above has set them
    set_fields = kind.__init__

    @functools.wraps(set_fields)
    def init(self: PycramError, *args: object, **kwargs: object) -> None:
        set_fields(self, *args, **kwargs)
        for name, convert in conversions.items():
            value = getattr(self, name)
            if value is not None:
                setattr(self, name, convert(value))
        self._complete()
        super(PycramError, self).__init__(self._message())

    kind.__init__ = init  # type: ignore[method-assign, assignment]  # ``init`` has the same parameters
    return kind


@dataclass_error
class BadArgument(UsageError, ValueError):
    """An impossible value of an argument (NaN, wrong length, zero quaternion, ...)."""

    argument: str  # name of the parameter that has the value
    value: object
    expected: str  # text about the accepted values

    _template = "{argument} = {value!r}: expected {expected}"


class JointLimitError(BadArgument):
    """A joint value in rad or m that is outside the limits of the joint's model."""

    def __init__(self, body: str, joint: str, value: float, lower: float, upper: float) -> None:
        super().__init__(f"joint {joint} of {body}", value, f"a value from {lower:g} to {upper:g}")
        self.body = body
        self.joint = joint
        self.lower = lower
        self.upper = upper


class UnknownName(UsageError, LookupError):
    """A name that a world, object or registry doesn't have."""

    def __init__(self, kind: str, name: object, owner: str, known: Iterable[str]) -> None:
        names = list(known)
        super().__init__(f"{owner} has no {kind} {name!r}; {suggestion(name, names)}")
        self.kind = kind  # kind of the name, such as "joint", "link" or "object".
        self.name = name
        self.owner = owner
        self.nearest = nearest(name, names)  # the owner's names that are most similar to ``name``


class AssetError(UsageError):
    """A model or mesh file that can't be used."""

    def __init__(self, path: str | Path, cause: str) -> None:
        super().__init__(f"{path}: {cause}")
        self.path = str(path)
        self.cause = cause


@dataclass_error
class AttachmentError(UsageError):
    """An impossible attachment: a cycle, an object with another carrier, or an object in another world."""

    carrier: str
    body: str
    reason: str

    _template = "{carrier} can't carry {body}: {reason}"


@dataclass_error
class ReadOnly(UsageError, AttributeError):
    """A plan assigned a read-only attribute; only methods change it, and record the change."""

    owner: str  # the world or object with the attribute
    attribute: str
    instead: str  # the method to use instead

    _template = "{attribute} of {owner} can't be assigned: {instead}"


class WorldClosed(UsageError):
    """A call for a world that has ended, or for an object that was removed."""

    def __init__(self, world: str, action: str, what: str = "the world") -> None:
        super().__init__(f"can't {action} in {world}: {what} is gone")
        self.world = world
        self.action = action


@dataclass_error
class NoWorld(UsageError):
    """There is no current world, or it has no robot."""

    what: str = "world"  # or "robot"

    def _message(self) -> str:
        if self.what == "world":
            return "there is no current world; open a world with BulletWorld()"
        return "the current world has no robot; set BulletWorld.robot"


@dataclass_error
class ChangeRefused(UsageError):
    """A reasoning query tried to change a world."""

    change: str
    query: str

    _template = "{change} was tried inside the query {query}; queries must not change a world"


@dataclass_error
class ObjectsChanged(UsageError):
    """A saved state can't be restored, because the world now has other objects."""

    world: str
    added: Sequence[str] = kept_as(tuple)  # names of the objects that were loaded after the state was saved
    removed: Sequence[str] = kept_as(tuple)  # names of the objects that were removed after the state was saved

    def _message(self) -> str:
        changes = ((self.added, "loaded"), (self.removed, "removed"))
        since = " and ".join(
            f"{', '.join(names)} {'were' if names[1:] else 'was'} {how}" for names, how in changes if names
        )
        return f"a saved state of {self.world} can't be restored, because {since} after the state was saved"


@dataclass_error
class FollowsTrajectory(UsageError):
    """A call that is impossible while a body follows a trajectory."""

    action: str
    body: str
    number: int  # number of the trajectory in its world
    joints: Sequence[str] = kept_as(tuple, default=())  # the trajectory's joints; empty for the base

    def _message(self) -> str:
        joints = self.joints
        listed = ", ".join(joints[:3]) + (f" and {len(joints) - 3} more" if len(joints) > 3 else "")
        moved = f"{listed or 'the base'} of {self.body}"
        remedy = f"wait for the trajectory's end, or call stop_trajectory({self.number})"
        return f"can't {self.action}: trajectory {self.number} moves {moved}; {remedy}"


@dataclass_error
class DisplayError(UsageError):
    """A window can't open."""

    reason: str

    _template = 'BulletWorld("GUI") can\'t open its window: {reason}; BulletWorld() runs without a window'


def chained(error: ErrorType, others: Iterable[BaseException]) -> ErrorType:
    """Append errors to the context chain of ``error``, each only once, so that all are printed; return ``error``."""
    for other in others:
        last: BaseException = error
        known = {id(last)}
        while (earlier := last.__cause__ or last.__context__) is not None and id(earlier) not in known:
            last = earlier
            known.add(id(last))
        if id(other) not in known and _detached(other, known):
            last.__context__ = other
            last.__suppress_context__ = False
    return error


def call_all(calls: Iterable[Callable[[], object]]) -> list[Exception]:
    """Make all calls, even after errors, and return the errors."""
    errors = []
    for call in calls:
        try:
            call()
        except Exception as error:  # noqa: BLE001  the caller raises the errors after all calls
            errors.append(error)
    return errors


class OnError:
    """Calls a function with the error that leaves its ``with`` block, also with an interrupt.

    A signal handler may still raise an error after the last statement of the block. The function isn't called for that
    error, so code that must handle every error needs ``except``.
    """

    def __init__(self, call: Callable[[BaseException], object], kind: type[BaseException] = BaseException) -> None:
        self._call = call
        self._kind = kind

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, self._kind):
            self._call(error)


def raise_unchanged(error: BaseException) -> NoReturn:
    """Raise an error with its own context, even while Python handles another error."""
    context = error.__context__
    try:
        raise error
    finally:
        error.__context__ = context


def _detached(error: BaseException, known: set[int]) -> bool:
    """Cut an error's context chain before the first known error; return False if ``raise ... from`` made the link."""
    seen: set[int] = set()
    later = error
    while id(later) not in seen:
        seen.add(id(later))
        earlier = later.__cause__ or later.__context__
        if earlier is None:
            break
        if id(earlier) in known:
            if later.__cause__ is not None:
                return False
            later.__context__ = None
            break
        later = earlier
    return True


def qualified_name(function: object) -> str:
    """Return the module and the qualified name of a callable; a partial has the name of its function."""
    while isinstance(function, partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    return escaped(f"{getattr(named, '__module__', '')}.{getattr(named, '__qualname__', '')}")


def export(module: str, *classes: type) -> None:
    """Make tracebacks and pickles name a module for classes: the module from which users import the classes."""
    for exported in classes:
        exported.__module__ = module
