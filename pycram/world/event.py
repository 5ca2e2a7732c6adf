"""Events and their handlers (thesis 4.2.3).

``Event.prepare`` records an event and returns a function that calls the handlers. A world prepares events while its
lock is held, so their records have the order of transactions. Handlers are called without the lock, so they may change
any world.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Self, TypeAlias

from pycram.foundation.errors import OnError, call_all, chained, qualified_name
from pycram.foundation.failures import BadArgument, UnknownName
from pycram.foundation.refusals import mark_recorded, refusing
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    Handler: TypeAlias = Callable[..., object]
    Envelope: TypeAlias = Callable[[], tuple[str, int]]


class Event:
    """An event with handlers.

    ``event += handler`` registers a handler once, ``event -= handler`` removes it, and ``event(...)`` or
    ``event.fire(...)`` calls all handlers in the order of registration. Handlers are called in the thread that fires
    the event, without a lock. First all handlers are called; then their first error is raised, with other errors as its
    context.
    """

    def __init__(
        self, name: str = "", sender: str = "", envelope: Envelope | None = None, parameters: Sequence[str] = ()
    ) -> None:
        self.name = name  # name in recordings, such as "attachment"
        self.sender = sender  # name of the sending world or object in recordings
        self._where = envelope  # returns the world's name and the number of simulated steps; None without a world
        self._parameters = tuple(parameters)  # names of positional arguments in recordings
        self._lock = threading.Lock()
        self._handlers: tuple[Handler, ...] = ()

    @property
    def handlers(self) -> tuple[Handler, ...]:
        """The registered handlers, in the order of registration."""
        return self._handlers

    def _envelope(self) -> tuple[str, int]:
        return self._where() if self._where is not None else ("", 0)

    @refusing("event", name="+=")
    def __iadd__(self, handler: Handler) -> Self:
        """Register a handler, which gets the event's arguments, once.

        Raises:
            BadArgument: The handler isn't callable.
            RecordingError: The registration can't be recorded; the handler isn't registered.
        """
        if not callable(handler):
            raise BadArgument(f"handler of {self}", handler, "a function")
        name = qualified_name(handler)
        with Uninterrupted(), self._lock:
            if handler not in self._handlers:
                self._record_subscription(name)
                self._handlers = (*self._handlers, handler)
        return self

    @refusing("event", name="-=")
    def __isub__(self, handler: Handler) -> Self:
        """Remove a registered handler.

        Raises:
            UnknownName: The handler isn't registered.
            RecordingError: The removal can't be recorded; the handler stays registered.
        """
        name = qualified_name(handler)
        with Uninterrupted(), self._lock:
            kept = tuple(known for known in self._handlers if known != handler)
            if len(kept) == len(self._handlers):
                raise UnknownName("handler", name, str(self), map(qualified_name, kept))
            self._record_subscription(name, removed=True)
            self._handlers = kept
        return self

    def _record_subscription(self, handler: str, *, removed: bool = False) -> None:
        if journal.recording():
            world, sim_step = self._envelope()
            record = records.Subscription(name=self.name, sender=self.sender, handler=handler, removed=removed)
            span.emit(record, world=world, sim_step=sim_step)

    def prepare(self, *args: object, **kwargs: object) -> Callable[[], None]:
        """Record the event, or raise RecordingError; return a function that calls the present handlers."""
        handlers = self._handlers
        steps: Mapping[Journal, int] = {}
        if journal.recording():
            world, sim_step = self._envelope()
            names = [*self._parameters[: len(args)], *map(str, range(len(self._parameters), len(args)))]
            record = records.Event(
                name=self.name,
                sender=self.sender,
                arguments=records.arguments([*zip(names, args, strict=True), *kwargs.items()]),
                handlers=[records.HandlerCall(handler=qualified_name(handler)) for handler in handlers],
            )
            steps = span.emit(record, world=world, sim_step=sim_step)

        def call_one(handler: Handler) -> None:
            with (
                span.span("handler", qualified_name(handler), {"event": self.name, "sender": self.sender}),
                OnError(mark_recorded, Exception),  # the handler's task has the error, so the call wasn't refused
            ):
                handler(*args, **kwargs)

        def call() -> None:
            with journal.caused_by(steps):
                errors = call_all(partial(call_one, handler) for handler in handlers)
            if errors:
                raise chained(errors[0], errors[1:])

        return call if handlers else lambda: None

    def fire(self, *args: object, **kwargs: object) -> None:
        """Record the event, then call the handlers with these arguments.

        Raises:
            RecordingError: The event can't be recorded; no handler is called.
        """
        self.prepare(*args, **kwargs)()

    __call__ = fire

    def __record__(self) -> object:
        """Return the event's reference in records."""
        return {"event": f"{self.name} of {self.sender}" if self.sender else self.name}

    def __repr__(self) -> str:
        text = f"event {self.name or 'without name'}"
        return f"{text} of {self.sender}" if self.sender else text
