"""Events: something happened, and everybody who registered for it is told (thesis 4.2.3).

Firing an event has two phases. ``prepare`` takes the handlers that are registered now and records the firing; what it
returns calls them. A world prepares under its lock, so that the order in the recording is the order of its changes, and
calls after the lock is released, so that a handler may do anything to any world. ``fire`` does both at once.
"""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from pycram.foundation.error_chain import chained
from pycram.foundation.failures import BadArgument, UnknownName
from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Self

    Handler: TypeAlias = Callable[..., object]
    Envelope: TypeAlias = Callable[[], tuple[str, int]]


class Event:
    """Something that can happen, with handlers that are called when it does.

    ``event += handler`` registers, ``event -= handler`` removes, ``event(...)`` or ``event.fire(...)`` tells all. A
    handler that is registered twice is called once. Handlers are called in the order of their registration, in the
    thread that fires, without any lock held. All are called even if one raises; then the first error is raised with
    the others in its context.
    """

    def __init__(
        self,
        name: str = "",
        sender: str = "",
        envelope: Envelope | None = None,
        parameters: Sequence[str] = (),
    ) -> None:
        """Makes an event without handlers.

        Args:
            name: what happened ("attachment", ...), for recordings.
            sender: name of the world or object to which it happens, for recordings.
            envelope: gives the name of the world and its simulated steps when the event fires; None for an event
                that belongs to no world.
            parameters: names of the positional arguments that it is fired with, for recordings; arguments beyond
                these are recorded under their index.
        """
        self.name = name
        self.sender = sender
        self._envelope = envelope
        self._parameters = tuple(parameters)
        self._lock = threading.Lock()
        self._handlers: tuple[Handler, ...] = ()

    @property
    def handlers(self) -> tuple[Handler, ...]:
        """Those who are told, in order."""
        return self._handlers

    def __iadd__(self, handler: Handler) -> Self:
        """Registers a handler, once.

        Args:
            handler: called with the arguments that the event is fired with.

        Raises:
            BadArgument: it can't be called.
        """
        if not callable(handler):
            raise BadArgument(f"handler of {self}", handler, "something that can be called")
        with self._lock:
            if handler not in self._handlers:
                self._handlers = (*self._handlers, handler)
        return self

    def __isub__(self, handler: Handler) -> Self:
        """Removes a handler.

        Args:
            handler: one that is registered.

        Raises:
            UnknownName: it isn't registered.
        """
        with self._lock:
            kept = tuple(known for known in self._handlers if known != handler)
            if len(kept) == len(self._handlers):
                raise UnknownName("handler", qualified_name(handler), str(self), map(qualified_name, kept))
            self._handlers = kept
        return self

    def prepare(self, *args: object, **kwargs: object) -> Callable[[], None]:
        """Records the firing; calls nobody yet.

        Args:
            *args: handed to the handlers.
            **kwargs: handed to the handlers.

        Returns:
            The call that tells the handlers which were registered when this was prepared.

        Raises:
            RecordingError: the firing can't be recorded.
        """
        handlers = self._handlers
        if journal.recording():
            world, sim_step = self._envelope() if self._envelope is not None else ("", 0)
            names = [*self._parameters[: len(args)], *map(str, range(len(self._parameters), len(args)))]
            record = records.Event(
                name=self.name,
                sender=self.sender,
                arguments=records.arguments([*zip(names, args, strict=True), *kwargs.items()]),
                handlers=[records.HandlerCall(handler=qualified_name(handler)) for handler in handlers],
            )
            journal.emit(record, world=world, sim_step=sim_step)

        def call() -> None:
            errors = [error for handler in handlers if (error := _told(handler, args, kwargs)) is not None]
            if errors:
                raise chained(errors[0], errors[1:])

        return call

    def fire(self, *args: object, **kwargs: object) -> None:
        """Records the firing, then calls the handlers.

        Args:
            *args: handed to the handlers.
            **kwargs: handed to the handlers.

        Raises:
            RecordingError: the firing can't be recorded; nobody is called then.
            Exception: the first error that a handler raised, when all have been called.
        """
        self.prepare(*args, **kwargs)()

    def __call__(self, *args: object, **kwargs: object) -> None:
        """The same as :meth:`fire`."""
        self.fire(*args, **kwargs)

    def __repr__(self) -> str:
        told = f"event {self.name or 'without name'}"
        return f"{told} of {self.sender}" if self.sender else told


def _told(handler: Handler, args: Sequence[object], kwargs: Mapping[str, object]) -> Exception | None:
    try:
        handler(*args, **kwargs)
    except Exception as error:  # noqa: BLE001  the others must be told too; whoever asked raises it
        return error
    return None


def qualified_name(handler: object) -> str:
    """How a callable is called in recordings: module and qualified name, of what it wraps if it is a partial."""
    while isinstance(handler, partial):
        handler = handler.func
    named = handler if hasattr(handler, "__qualname__") else type(handler)
    return f"{getattr(named, '__module__', '')}.{getattr(named, '__qualname__', '')}"
