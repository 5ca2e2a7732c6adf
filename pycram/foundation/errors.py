"""Errors: base classes, usage errors, and chains of errors.

A :class:`PlanFailure` means that the world prevents an action: a plan may catch it and try something else. A
:class:`UsageError` means that the program is wrong: nothing should catch it. Every error keeps its data as attributes,
which are recorded with the message. Errors of a plan may be dataclasses, also frozen ones: Python can still set the
traceback and the context while the error propagates.

An error of PyCRAM is a dataclass of its data, with a template for the message::

    @dataclass_error
    class GraspFailed(PlanFailure):
        # (docstring)
        arm: str  # "left" or "right"
        body: str
        widths: Sequence[float] = kept_as(floats, default=())  # m, between the fingers

        _template = "{arm} gripper can't grasp {body}"

- Fields are the constructor's parameters, and the recorded data in the same order. ``kept_as`` copies a given value.
- If the message needs more than a template, override ``_message()``, which returns it from the fields.
- If a field depends on others, set it in ``_complete()``, which runs before the message is made.
- If parameters and fields differ, write ``__init__`` instead, and call ``super().__init__(message)``.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields
from functools import partial
from types import MemberDescriptorType
from typing import TYPE_CHECKING, Any, ClassVar, Final, NoReturn, TypeVar, cast, dataclass_transform
from weakref import WeakSet

from recorder import notebook
from recorder.errors import nearest, suggestion
from recorder.records import escaped

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Self


Given = TypeVar("Given")
ErrorType = TypeVar("ErrorType", bound=BaseException)


class PycramError(Exception):
    """Base of all errors that PyCRAM defines."""

    _template: ClassVar[str] = ""  # message of a dataclass error, with its fields in braces

    def __new__(cls, *args: object, **kwargs: object) -> Self:
        """Make an instance that can be raised even if its class refuses assignments."""
        if cls not in _raisable:
            _make_raisable(cls)
        return super().__new__(cls, *args, **kwargs)

    @property
    def data(self) -> Mapping[str, object]:
        """The error's fields by name."""
        slots = {slot.__name__: slot.__get__(self) for slot in slots_of(self)}
        return {name: value for name, value in (slots | vars(self)).items() if not name.startswith("_")}

    def _complete(self) -> None:
        """Set fields that depend on others."""

    def _message(self) -> str:
        return self._template.format_map(vars(self))

    def _render_traceback_(self) -> list[str]:
        """Return the lines that IPython prints."""
        return notebook.traceback_lines(self)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy the error with its fields, as the class can't be called with the message alone."""
        slots = {slot.__name__: slot.__get__(self) for slot in slots_of(self)}
        return _restored, (type(self), self.args, slots, dict(vars(self)))


class PlanFailure(PycramError):
    """The world prevents an action; a plan may handle the failure."""


class UsageError(PycramError):
    """The program is wrong; plans must not handle the error."""


def kept_as(convert: Callable[[Given], object], **default: Given | None) -> Given:
    """Return a field of a dataclass error that stores the result of ``convert`` (list, dict, ...); None stays None."""
    return cast("Given", field(**default, metadata={"convert": convert}))  # type: ignore[call-overload]  # default is the only keyword


def floats(values: Sequence[float]) -> list[float]:
    """Return numbers, which may be given as an array, as Python floats."""
    return [float(value) for value in values]


@dataclass_transform(eq_default=False, field_specifiers=(field, kept_as))
def dataclass_error(kind: type[ErrorType]) -> type[ErrorType]:
    """Make an error a dataclass whose message comes from its template or its ``_message()``.

    The traces of the dataclass are removed, so a dataclass that a plan derives from it may be frozen, and has only its
    own fields. Errors stay equal by identity, and print like other exceptions.
    """
    dataclass(eq=False, repr=False, match_args=False)(kind)
    conversions = {each.name: each.metadata["convert"] for each in fields(cast("Any", kind)) if each.metadata}
    del kind.__dataclass_fields__, kind.__dataclass_params__  # type: ignore[attr-defined]  # made above
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

    kind.__init__ = init  # type: ignore[method-assign, assignment]  # with the same parameters
    return kind


def _restored(
    kind: type[PycramError], args: tuple[object, ...], slots: Mapping[str, object], fields: Mapping[str, object]
) -> PycramError:
    """Return an error from its pickled parts."""
    error = kind.__new__(kind, *args)
    vars(error).update(fields)  # assignments could be rejected by the error's class
    for name, value in slots.items():
        getattr(kind, name).__set__(error, value)
    return error


def slots_of(error: PycramError) -> Iterator[MemberDescriptorType]:
    """Yield the slots of an error's fields, which dataclasses with ``slots=True`` have."""
    for base in type(error).__mro__:
        if issubclass(base, PycramError):
            for slot in vars(base).values():
                if isinstance(slot, MemberDescriptorType) and hasattr(error, slot.__name__):
                    yield slot


#: Attributes that Python and context managers set on an exception that propagates.
_SET_BY_PYTHON: Final = frozenset({"__cause__", "__context__", "__notes__", "__suppress_context__", "__traceback__"})

_raisable: Final[WeakSet[type[PycramError]]] = WeakSet()


def _make_raisable(kind: type[PycramError]) -> None:
    """Let Python set its attributes on instances of a class that prevents assignments, as frozen dataclasses do.

    This is done with the first instance: a dataclass gets its ``__setattr__`` only after ``__init_subclass__``.
    """
    for base in kind.__mro__:
        if issubclass(base, PycramError) and base not in _raisable:
            _raisable.add(base)
            if "__setattr__" in vars(base):
                _allow_python(base)


def _allow_python(kind: type[PycramError]) -> None:
    assign = kind.__setattr__

    @functools.wraps(assign)
    def set_or_assign(error: PycramError, name: str, value: object) -> None:
        if name in _SET_BY_PYTHON:
            BaseException.__setattr__(error, name, value)
        else:
            assign(error, name, value)

    kind.__setattr__ = set_or_assign  # type: ignore[method-assign, assignment]  # wraps the method of the class


@dataclass_error
class BadArgument(UsageError, ValueError):
    """An impossible value of an argument (NaN, wrong length, zero quaternion, ...)."""

    argument: str  # name of the parameter
    value: object
    expected: str  # description of accepted values

    _template = "{argument} = {value!r}: expected {expected}"


class JointLimitError(BadArgument):
    """A joint value outside the limits of the model, in rad or m."""

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
        self.kind = kind  # "joint", "link", "object", ...
        self.name = name
        self.owner = owner
        self.nearest = nearest(name, names)  # the most similar names that the owner has


class AssetError(UsageError):
    """A model or mesh file that can't be used."""

    def __init__(self, path: str | Path, cause: str) -> None:
        super().__init__(f"{path}: {cause}")
        self.path = str(path)
        self.cause = cause


@dataclass_error
class AttachmentError(UsageError):
    """An attachment that is impossible (cycle, itself, another world, already carried)."""

    carrier: str
    body: str
    reason: str

    _template = "{carrier} can't carry {body}: {reason}"


@dataclass_error
class ReadOnly(UsageError, AttributeError):
    """A read-only attribute was assigned; methods change it, and record the change."""

    owner: str  # the world or object
    attribute: str
    instead: str  # what to do instead

    _template = "{attribute} of {owner} can't be assigned: {instead}"


class WorldClosed(UsageError):
    """An action was tried in a world after its end, or on an object after its removal."""

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
            return "there is no current world; open one with BulletWorld()"
        return "the current world has no robot; set BulletWorld.robot"


@dataclass_error
class ChangeRefused(UsageError):
    """A change of a world was tried inside a reasoning query."""

    change: str
    query: str

    _template = "{change} was tried inside the query {query}; queries must not change a world"


@dataclass_error
class ObjectsChanged(UsageError):
    """A state of a world can't be restored, as it was saved with other objects."""

    world: str
    added: Sequence[str] = kept_as(tuple)  # names of the objects that were loaded since
    removed: Sequence[str] = kept_as(tuple)  # names of the objects that were removed since

    def _message(self) -> str:
        changes = ((self.added, "loaded"), (self.removed, "removed"))
        since = " and ".join(
            f"{', '.join(names)} {'were' if names[1:] else 'was'} {how}" for names, how in changes if names
        )
        return f"a saved state of {self.world} can't be restored, because {since} since it was saved"


@dataclass_error
class FollowsTrajectory(UsageError):
    """An action can't be done while a body follows a trajectory."""

    action: str
    body: str
    number: int  # number of the trajectory in its world
    joints: Sequence[str] = kept_as(tuple, default=())  # names of the joints that it moves; none for the base

    def _message(self) -> str:
        joints = self.joints
        listed = ", ".join(joints[:3]) + (f" and {len(joints) - 3} more" if len(joints) > 3 else "")
        moved = f"{listed or 'the base'} of {self.body}"
        remedy = f"wait until it has ended, or stop it with stop_trajectory({self.number})"
        return f"can't {self.action}: trajectory {self.number} moves {moved}; {remedy}"


@dataclass_error
class DisplayError(UsageError):
    """A window can't open."""

    reason: str

    _template = 'BulletWorld("GUI") can\'t open its window: {reason}; BulletWorld() runs without a window'


def chained(error: ErrorType, others: Iterable[BaseException]) -> ErrorType:
    """Append other errors to an error's context chain, so that tracebacks print all of them, and return the error.

    Errors that the chain already has are left out.
    """
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
        except Exception as error:  # noqa: BLE001  any error: the caller raises them after all calls
            errors.append(error)
    return errors


class OnError:
    """Calls a function with an error of its ``with`` block, also with an interrupt; then the error propagates.

    An error that a signal handler raises at the end of the block, after its last statement, may pass without a call:
    code that must not miss it needs ``except``.
    """

    __slots__ = ("_call", "_kind")

    def __init__(self, call: Callable[[BaseException], object], kind: type[BaseException] = BaseException) -> None:
        self._call = call
        self._kind = kind

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, self._kind):
            self._call(error)


def raise_unchanged(error: BaseException) -> NoReturn:
    """Raise an error with its own context, even while another error is being handled."""
    context = error.__context__
    try:
        raise error
    finally:
        error.__context__ = context


def _detached(error: BaseException, known: set[int]) -> bool:
    """Cut an error's context chain before the known errors, so that appending it to them makes no circle.

    Returns:
        False if it was raised explicitly ``from`` one of them: such a chain isn't cut.
    """
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
    """Return module and qualified name of a callable; for a partial, of the wrapped function."""
    while isinstance(function, partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    return escaped(f"{getattr(named, '__module__', '')}.{getattr(named, '__qualname__', '')}")


def export(module: str, *classes: type) -> None:
    """Set the module from which users import classes, for tracebacks and pickles."""
    for exported in classes:
        exported.__module__ = module
