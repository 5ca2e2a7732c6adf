"""Events, and the handlers that are called when they happen (thesis 4.2.3).

Firing an event has two phases. ``prepare`` records it and returns a call of the handlers that are registered now. A
world prepares under its lock, so that events are recorded in the order of its transactions, and calls when the lock is
released, so that a handler may do anything to any world. ``fire`` does both at once.
"""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from pycram.foundation.error_chain import call_all, chained
from pycram.foundation.failures import BadArgument, UnknownName
from pycram.foundation.names import qualified_name
from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Self

    Handler: TypeAlias = Callable[..., object]
    Envelope: TypeAlias = Callable[[], tuple[str, int]]


class Event:
    """Something that can happen, with handlers that are called when it does.

    ``event += handler`` registers, ``event -= handler`` removes, ``event(...)`` or ``event.fire(...)`` calls all. A
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
        """Make an event without handlers.

        Args:
            name: What happens ("attachment", ...), for recordings.
            sender: Name of the world or object to which it happens, for recordings.
            envelope: Returns the world's name and simulated steps when the event fires; None for no world.
            parameters: Names of the positional arguments, for recordings; further ones are recorded by their index.
        """
        self.name = name
        self.sender = sender
        self._envelope = envelope
        self._parameters = tuple(parameters)
        self._lock = threading.Lock()
        self._handlers: tuple[Handler, ...] = ()

    @property
    def handlers(self) -> tuple[Handler, ...]:
        """The registered handlers, in order."""
        return self._handlers

    def __iadd__(self, handler: Handler) -> Self:
        """Register a handler, once; it is called with the event's arguments.

        Raises:
            BadArgument: It isn't callable.
        """
        if not callable(handler):
            raise BadArgument(f"handler of {self}", handler, "something that can be called")
        with self._lock:
            if handler not in self._handlers:
                self._handlers = (*self._handlers, handler)
        return self

    def __isub__(self, handler: Handler) -> Self:
        """Remove a registered handler.

        Raises:
            UnknownName: It isn't registered.
        """
        with self._lock:
            kept = tuple(known for known in self._handlers if known != handler)
            if len(kept) == len(self._handlers):
                raise UnknownName("handler", qualified_name(handler), str(self), map(qualified_name, kept))
            self._handlers = kept
        return self

    def prepare(self, *args: object, **kwargs: object) -> Callable[[], None]:
        """Record the event, and return the call of the present handlers with these arguments.

        Raises:
            RecordingError: It can't be recorded.
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
            errors = call_all(partial(handler, *args, **kwargs) for handler in handlers)
            if errors:
                raise chained(errors[0], errors[1:])

        return call

    def fire(self, *args: object, **kwargs: object) -> None:
        """Record the event, then call the handlers with these arguments.

        Raises:
            RecordingError: It can't be recorded; no handler is called then.
            Exception: The first error that a handler raised, when all have been called.
        """
        self.prepare(*args, **kwargs)()

    def __call__(self, *args: object, **kwargs: object) -> None:
        """Do the same as :meth:`fire`."""
        self.fire(*args, **kwargs)

    def __repr__(self) -> str:
        text = f"event {self.name or 'without name'}"
        return f"{text} of {self.sender}" if self.sender else text
