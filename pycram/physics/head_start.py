"""A head start: what all runs of a sweep ask of the engine first is done once, and forks begin with the answers.

Runs of one plan mostly begin alike: they load the same models and let them come to rest. What a physics client becomes
follows from the calls that it gets, bit for bit. So runs note them (:func:`noted`), the sweep makes those that all have
in common (:class:`HeadStart`), and a fork that asks the same, to the last bit, gets the answers that are there
(:meth:`HeadStart.taken`). At its first call that is another one it goes on with that client, if the client has had no
more calls than it has made; else with a new one, which gets them again.
"""

from __future__ import annotations

import base64
import marshal
import pickle
from abc import ABC, abstractmethod
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from pycram.foundation.redirect import silenced
from pycram.physics import engine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

#: A function's name and arguments, as bytes that differ if one bit does, and what it returned.
Call: TypeAlias = tuple[bytes, Any]

_MAX_NOTED: Final = 5000  # calls of a client
_CLIENT: Final = "physicsClientId"
_EXACT: Final = 2  # marshal's last format in which equal values are equal bytes


@dataclass(slots=True)
class _Begun:
    """A physics client and the calls that it has had since its beginning."""

    client: int
    calls: list[Call] = field(default_factory=list)


@dataclass(slots=True)
class Notes:
    """The calls that clients have had, in the order in which they began."""

    clients: list[_Begun] = field(default_factory=list)

    def text(self) -> str:
        """Return it as text for :class:`HeadStart`."""
        return base64.b64encode(pickle.dumps([begun.calls for begun in self.clients])).decode()


@contextmanager
def noted() -> Iterator[Notes]:
    """Take notes while the block runs."""
    notes = Notes()
    with _between(_Noting(notes)):
        yield notes


class HeadStart:
    """Physics clients that have had the calls with which all runs begin.

    Args:
        runs: What runs have noted: forks of this process, so it can be trusted.
    """

    def __init__(self, *runs: str) -> None:
        self._begun: list[_Begun] = []
        noted = [pickle.loads(base64.b64decode(run)) for run in runs]  # noqa: S301  see above
        with silenced(1):  # native code prints
            for clients in zip(*noted, strict=False):
                begun = _Begun(engine.bullet.connect(engine.bullet.DIRECT), _common(clients))
                self._begun.append(begun)
                if not _repeats(begun):
                    self.close()
                    return

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Have the engine begin with these clients while the block runs, in a fork that ends with it."""
        with _between(_Following(self._begun)):
            yield

    def close(self) -> None:
        """End the clients."""
        while self._begun:
            engine.bullet.disconnect(physicsClientId=self._begun.pop().client)


class _Between(ABC):
    """Stands between the engine and PyBullet."""

    def __init__(self) -> None:
        self.bullet = engine.bullet

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.bullet, name)
        if callable(found) and not isinstance(found, type):
            found = partial(self._call, found)
            setattr(self, name, found)
        return found

    @abstractmethod
    def _call(self, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        """Answer a call of a function of PyBullet."""

    def _begins(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
        """Return whether a call begins a client without a window."""
        return function is self.bullet.connect and arguments == (self.bullet.DIRECT,)


class _Noting(_Between):
    def __init__(self, notes: Notes) -> None:
        super().__init__()
        self._notes = notes
        self._open: dict[int, _Begun] = {}  # clients whose next call belongs to their beginning

    def _call(self, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        begun = self._open.pop(keywords.get(_CLIENT, -1), None)
        answer = function(*arguments, **keywords)
        if self._begins(function, arguments):
            self._open[answer] = begun = _Begun(answer)
            self._notes.clients.append(begun)
        elif begun is not None and len(begun.calls) < _MAX_NOTED and function is not self.bullet.disconnect:
            content = _content(function, arguments, keywords)
            if content is not None:
                begun.calls.append((content, answer))
                self._open[begun.client] = begun
        return answer


class _Following(_Between):
    def __init__(self, clients: Sequence[_Begun]) -> None:
        super().__init__()
        self._unused = deque(clients)
        self._ahead: dict[int, deque[Call]] = {}  # by client: what it has had and wasn't asked yet
        self._asked: dict[int, list[Call]] = {}
        self._instead: dict[int, int] = {}  # clients in place of those that have had too much

    def _call(self, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        client = keywords.get(_CLIENT, -1)
        if client in self._ahead:
            ahead = self._ahead[client]
            if ahead and ahead[0][0] == _content(function, arguments, keywords):
                self._asked[client].append(ahead[0])
                return ahead.popleft()[1]
            self._go_on(client)
        if client in self._instead:
            keywords[_CLIENT] = self._instead[client]
        elif self._unused and self._begins(function, arguments):
            begun = self._unused.popleft()
            self._ahead[begun.client], self._asked[begun.client] = deque(begun.calls), []
            return begun.client
        return function(*arguments, **keywords)

    def _go_on(self, client: int) -> None:
        """Go on with a client that is asked for something else."""
        asked = self._asked.pop(client)
        if self._ahead.pop(client):
            self._instead[client] = anew = self.bullet.connect(self.bullet.DIRECT)
            for call in asked:
                _make(self.bullet, call, anew)
        if not (self._ahead or self._unused or self._instead):
            engine.bullet = self.bullet  # nothing is left to do here


@contextmanager
def _between(what: _Between) -> Iterator[None]:
    engine.bullet = what
    try:
        yield
    finally:
        engine.bullet = what.bullet


def _common(runs: Sequence[Sequence[Call]]) -> list[Call]:
    """Return the calls with which all begin."""
    alike = takewhile(lambda calls: all(_same(each, calls[0]) for each in calls), zip(*runs, strict=False))
    return [first for first, *_ in alike]


def _repeats(begun: _Begun) -> bool:
    """Make a client's calls, and return whether it answers as it did."""
    try:
        return all(_same(_make(engine.bullet, call, begun.client), call[1]) for call in begun.calls)
    except engine.bullet.error:
        return False


def _same(a: object, b: object) -> bool:
    return repr(a) == repr(b)  # to the last bit, unlike ==


def _content(function: Callable[..., Any], arguments: tuple[Any, ...], keywords: dict[str, Any]) -> bytes | None:
    """Return what is called, whichever client it is; None where the arguments aren't plain values."""
    try:
        return marshal.dumps((function.__name__, arguments, keywords | {_CLIENT: 0}), _EXACT)
    except ValueError:
        return None


def _make(bullet: Any, call: Call, client: int) -> Any:
    name, arguments, keywords = marshal.loads(call[0])  # noqa: S302  from our own fork
    return getattr(bullet, name)(*arguments, **keywords | {_CLIENT: client})
