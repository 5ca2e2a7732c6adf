"""Designators: descriptions of motions, actions, objects and places, resolved late (thesis 3.5.1, 4.5, 4.6).

Resolvers find solutions of a designator: dictionaries with all parameters. The first solution is the *reference*.
Further solutions belong to *equated* designators with the same slots, which form a chain. A designator is *effective*
if its solution is found, or if it has the data of :meth:`Designator.make_effective`.
"""

from __future__ import annotations

import itertools
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Self, TypeAlias, TypeVar

from pycram.foundation.errors import chained, qualified_name
from pycram.foundation.failures import BadArgument, UnknownName
from pycram.foundation.forcing import forced
from pycram.foundation.refusals import refusing
from pycram.motions import motion_types
from pycram.motions.resources import Resources
from pycram.motions.slots import Description, DesignatorError, SolutionSlots, Value, own, pairs, same, slot_name
from pycram.reasoning.choosing import Question
from pycram.scheduling.cancellation import Binding
from pycram.scheduling.future import Future, Pending, branches_in, unwrap
from recorder.tracing import journal

__all__ = ["Designator", "DesignatorError", "MotionDesignator", "ResolvedDesignator", "Solution"]

_chains_lock = threading.Lock()  # one lock serves all chains, because chains can be joined

Solution: TypeAlias = Mapping[str, Any]  # all parameters of a motion, action, object or place, by name
Resolver: TypeAlias = Callable[[Any], Iterable[Solution] | None]
Function = TypeVar("Function", bound="Callable[..., object]")


class Resolvers(Generic[Function]):
    """Functions of users, called in order until one answers. Iteration uses a copy of the list."""

    def __init__(self, owner: str) -> None:
        self.owner = owner  # the objects that the functions resolve, for messages
        self._lock = threading.Lock()
        self._functions: tuple[Function, ...] = ()

    def append(self, function: Function) -> Function:
        """Add a function at the end, unless it is already registered, and return it; also usable as a decorator."""
        if not callable(function):
            raise BadArgument(f"resolver of {self.owner}", function, "a function that takes a designator")
        with self._lock:
            if function not in self._functions:
                self._functions = (*self._functions, function)
        return function

    def remove(self, function: Function) -> None:
        """Remove a function; raise UnknownName if it isn't registered."""
        with self._lock:
            kept = tuple(known for known in self._functions if known != function)
            if len(kept) == len(self._functions):
                raise UnknownName("resolver", qualified_name(function), self.owner, map(qualified_name, kept))
            self._functions = kept

    @contextmanager
    def added(self, function: Function) -> Iterator[Function]:
        """Register a new function during the ``with`` block."""
        self.append(function)
        try:
            yield function
        finally:
            self.remove(function)

    def __iter__(self) -> Iterator[Function]:
        return iter(self._functions)

    def __len__(self) -> int:
        return len(self._functions)


@dataclass(frozen=True, slots=True)
class Resolution:
    """How a solution was found."""

    resolver: str = ""  # qualified name of the function that found the solution; "" if no function found it
    index: int = 0  # index of the solution, from 0
    known: int = 1  # number of solutions that are known so far
    complete: bool = False  # whether all solutions are known


class Solutions:
    """The solutions that a designator and its successors have in common, in any number of threads.

    Resolvers run without a lock, because they may wait for a thread that requests the same solutions. All concurrent
    threads search, and use the solution that is found first. ``find`` yields solutions and the names of their
    resolvers; after a failure, ``find`` is called again, and known solutions are skipped.
    """

    def __init__(self, find: Callable[[], Iterator[tuple[Solution, str]]]) -> None:
        self._lock = threading.Lock()
        self._find = find
        self._rest: Iterator[tuple[Solution, str]] | None = None  # yields the solutions that aren't known yet
        self._kept: list[tuple[Solution, str]] = []
        self._complete = False

    def at(self, index: int) -> Solution | None:
        """Return the solution with an index from 0; None if there is no such solution."""
        while True:
            with self._lock:
                count = len(self._kept)
                if index < count or self._complete:
                    return self._kept[index][0] if index < count else None
                rest, self._rest = self._rest, None
            if rest is None:
                rest = itertools.islice(self._find(), count, None)
            solution = next(rest, None)
            with self._lock:
                if len(self._kept) == count:  # no other thread has found this solution before
                    self._rest = rest
                    self._complete = solution is None
                    if solution is not None:
                        self._kept.append(solution)

    def resolution(self, index: int) -> Resolution:
        """Return how the solution with an index was found; the resolver is "" without such a solution."""
        with self._lock:
            resolver = self._kept[index][1] if index < len(self._kept) else ""
            return Resolution(resolver, index, len(self._kept), self._complete)


#: The designators that this branch performs now; a motion may consist of motions.
_performed: ContextVar[tuple[Designator, ...]] = ContextVar("pycram_performed", default=())


def performing(designator: Designator) -> Binding[tuple[Designator, ...]]:
    """Don't record requests for solutions in the ``with`` block: they are part of performing a designator."""
    return Binding(_performed, (*_performed.get(), designator))


@contextmanager
def _recorded(name: str, designator: Designator, index: int | None = None) -> Iterator[Question]:
    """Record a plan's request for a solution, which the ``with`` block answers.

    The caller records a UsageError as a refusal; the record contains other failures. ``name`` is "reference" or
    "next_solution". ``index`` is the index of the solution; by default, the index of the designator's own solution.
    """
    request = Question(name, {"designator": designator})
    if any(each is designator for each in _performed.get()) or not journal.recording():
        yield request
        return
    with performing(designator), request.recorded(journal.current_world):
        try:
            yield request
        finally:
            found = designator.resolution(index)
            resolver = {"resolver": found.resolver} if found.resolver else {}
            request.evidence = {**resolver, "index": found.index, "known": found.known, "complete": found.complete}


class Designator(ABC):
    """A description of something by slots: ``Designator([("type", "milk")])`` or ``Designator(type="milk")``.

    Args:
        description: Slots as (key, value) pairs or a mapping. A value may be a future of a ``par`` block, or another
            designator, which is resolved together with this designator.
        parent: An older designator to equate with this designator.
        slots: Further slots; ``reachable_for`` is the slot ``reachable-for``, ``in_`` is the slot ``in``.

    Raises:
        DesignatorError: The description isn't a list of pairs.
    """

    performed_by: ClassVar[str] = ""
    """Qualified name of the function that performs the designator; "" for ``ProcessModule.perform``."""

    @refusing("designator", name="Designator")
    def __init__(self, description: Description = (), parent: Designator | None = None, **slots: object) -> None:
        self._chain: list[Any] = [self]  # equated designators
        self._slots = pairs(description) + pairs((slot_name(name), value) for name, value in slots.items())
        self._lock = threading.Lock()
        self._effective = False
        self._data: Value = None
        self.timestamp: float | None = None  # time at which the designator became effective, in s since the Unix epoch
        if parent is not None:
            self.equate(parent)

    @property
    def description(self) -> list[tuple[str, Value]]:
        """The slots as the plan wrote them."""
        return list(pairs(self._slots))

    def prop_value(self, key: str) -> Value:
        """Return a copy of a slot's value, or None for a missing slot; wait for the result of a future."""
        wanted = slot_name(key)
        return next((own(unwrap(value)) for name, value in self._slots if slot_name(name) == wanted), None)

    def check_constraints(self, properties: Iterable[str | tuple[str, object]]) -> bool:
        """Whether the slots satisfy all constraints.

        Args:
            properties: Names of slots that must not be None, and (name, value) pairs of slots that must have a value.
        """
        for constraint in [properties] if isinstance(properties, str) else properties:
            if isinstance(constraint, str):
                if self.prop_value(constraint) is None:
                    return False
                continue
            ((name, value),) = pairs([constraint])
            if not same(self.prop_value(name), value):
                return False
        return True

    def make_dictionary(self, properties: Iterable[str | tuple[str, object]]) -> dict[str, Value]:
        """Make a solution from the named slots, and from further (key, value) pairs."""
        given = ((item, self.prop_value(item)) if isinstance(item, str) else item for item in properties)
        return {key: unwrap(value) for key, value in pairs(given)}

    def branches(self) -> Iterator[Pending]:
        """Yield the branches of all futures in the slots, also in slots of inner designators, without waiting."""
        for _, value in self._slots:
            # isinstance() would wait for a future's result
            yield from value.branches() if issubclass(type(value), Designator) else branches_in(value)

    def check(self) -> None:  # noqa: B027  most classes have nothing to check
        """Check the slots without a search; raise UsageError if a slot is missing, unknown or wrong."""

    def values_for(self, slot: str, given: Mapping[str, Value]) -> Iterator[Mapping[str, Value]]:  # noqa: ARG002  for subclasses
        """Yield values for the slots of an outer designator, for each solution of this designator.

        Args:
            slot: The slot of the outer designator whose value is this designator.
            given: All slots that the outer designator has.

        Yields:
            Values by slot: for ``slot``, and for other slots that follow from these values.

        Raises:
            DesignatorError: This designator can't be the value of a slot.
        """
        raise DesignatorError(f"a {type(self).__name__} can't be the value of slot {slot}", slot=slot, value=self)

    def equate(self, other: Self) -> None:
        """Equate this designator with another designator: append it to the chain of ``other``."""
        if not isinstance(other, Designator):
            raise BadArgument("other", other, "another designator")
        with _chains_lock:
            own, theirs = self._chain, other._chain
            if own is theirs:
                return
            index = own.index(self)
            theirs[:0] = own[:index]  # older designators precede the chain of ``other``
            theirs += own[index:]
            for link in own:
                link._chain = theirs  # noqa: SLF001  same class

    def chain(self) -> list[Self]:
        """Return all designators of the chain, the oldest first."""
        with _chains_lock:
            return list(self._chain)

    def equal(self, other: Self) -> bool:
        """Return whether another designator is in the same chain."""
        with _chains_lock:
            return isinstance(other, Designator) and self._chain is other._chain

    def first(self) -> Self:
        """Return the oldest designator of the chain."""
        return self.chain()[0]

    def current(self) -> Self:
        """Return the newest designator of the chain."""
        return self.chain()[-1]

    def newest_effective(self) -> Designator | None:
        """Return the newest effective designator of the chain; None if no designator is effective."""
        return next((designator for designator in reversed(self.chain()) if designator.effective), None)

    @property
    def effective(self) -> bool:
        """Whether the designator has a reference: a found solution, or the data of :meth:`make_effective`."""
        return self._effective

    @property
    def data(self) -> Value:
        """The argument ``data`` of :meth:`make_effective`; None for other designators."""
        return self._data

    @abstractmethod
    def _solution(self) -> Solution:
        """Find the solution of this designator in any thread; raise DesignatorError if there is no solution."""

    @refusing("designator")
    def reference(self) -> Solution:
        """Return the solution, which the first call finds; or the data of :meth:`make_effective`.

        Raises:
            DesignatorError: There is no solution.
        """
        with _recorded("reference", self) as asked:
            asked.answer = solution = self._referenced()
        return solution

    def _referenced(self) -> Solution:
        if self._data is not None:
            known: Solution = self._data
            return known
        solution = self._solution()  # without a lock, because this calls code of the user
        with self._lock:
            self._effective = True
            if self.timestamp is None:
                self.timestamp = time.time()
        found = own(solution)
        return SolutionSlots(found) if type(found) is dict else found

    def resources(self) -> Resources | None:
        """Return the needed parts of the robot; None for all. The method must not wait or fail."""
        return None

    def resolution(self, index: int | None = None) -> Resolution:
        """Return how a solution was found, by default the designator's own; the resolver is "" if none was found."""
        resolver = qualified_name(type(self)._solution) if self._data is None else ""  # noqa: SLF001  same class
        return Resolution(resolver, index or 0)

    def next_solution(self) -> Self | None:
        """Return an equated designator with the same slots and the next solution; None without a next solution."""
        return None

    def solutions(self, from_root: object = None) -> Iterator[Solution]:
        """Yield this and all further solutions, each found on demand; raise DesignatorError if there is none.

        If ``from_root`` is true, start with the oldest designator of the chain.
        """
        start = self if from_root is None or from_root is False else self.first()
        return start._all_solutions()  # noqa: SLF001  same class

    def _all_solutions(self) -> Iterator[Solution]:
        designator: Designator | None = self
        while designator is not None:
            yield designator.reference()
            designator = designator.next_solution()

    def copy(self, new_properties: Description | None = None) -> Self:
        """Return a new designator of the same class, in a new chain.

        Args:
            new_properties: Slots that replace slots of the same name, or are appended.
        """
        slots = list(self._slots)
        for key, value in pairs(new_properties or ()):
            indices = [index for index, (name, _) in enumerate(slots) if slot_name(name) == slot_name(key)]
            for index in indices:
                slots[index] = (key, value)
            if not indices:
                slots.append((key, value))
        return type(self)(slots)

    def make_effective(
        self, properties: Description | None = None, data: Value = None, timestamp: float | None = None
    ) -> Self:
        """Return a new effective designator in the same chain, for something that the robot has found.

        Args:
            properties: Slots of the new designator; by default the slots of this designator.
            data: Reference of the new designator.
            timestamp: Time in s since the Unix epoch; by default the present time.
        """
        designator = type(self)(self._slots if properties is None else properties)
        designator._effective = True  # noqa: SLF001  same class
        designator._data = unwrap(data)  # noqa: SLF001  same class
        designator.timestamp = time.time() if timestamp is None else timestamp
        designator.equate(self)
        return designator

    def __reduce__(self) -> tuple[type[Designator], tuple[list[tuple[str, Value]]]]:
        """Pickle as a new designator with the same slots, in a new chain."""
        return type(self), (list(self._slots),)

    def __record__(self) -> object:
        """Return the slots by name."""
        slots: dict[str, object] = {}
        for name, value in self._slots:
            slots.setdefault(name, value.__record__() if isinstance(value, Future) else value)
        return slots

    def __repr__(self) -> str:
        return f"{type(self).__name__}({list(self._slots)!r})"


class ResolvedDesignator(Designator):
    """A designator whose solutions are found by resolvers, one by one.

    A resolver takes the designator and returns a list or a generator of solutions, or None for designators of other
    types. Users add resolvers with :meth:`add_resolver`, also a decorator. The order of calls is: resolvers of the
    subclass, resolvers of its parents, PyCRAM's resolver. If a resolver raises DesignatorError, the next resolver is
    called; if no resolver has a solution, the error is raised.
    """

    resolvers: ClassVar[Resolvers[Resolver]] = Resolvers("designators")

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        cls.resolvers = Resolvers(cls.__name__)

    def __init__(self, description: Description = (), parent: Designator | None = None, **slots: object) -> None:
        super().__init__(description, parent, **slots)
        self._solutions = Solutions(self._resolve)
        self._index = 0

    @staticmethod
    @abstractmethod
    def _own_resolver() -> Resolver:
        """Return PyCRAM's resolver, which is called last."""

    @classmethod
    def add_resolver(cls, resolver: Resolver) -> Resolver:
        """Add a resolver for this class and its subclasses after the other resolvers; return the resolver."""
        return cls.resolvers.append(resolver)

    @classmethod
    def remove_resolver(cls, resolver: Resolver) -> None:
        """Remove a resolver; raise UnknownName if it wasn't added to this class."""
        cls.resolvers.remove(resolver)

    @property
    def type(self) -> str:
        """The value of the slot ``type``; "" without this slot."""
        value = self.prop_value("type")
        return value if isinstance(value, str) else ""

    def next_solution(self) -> Self | None:
        """Return a designator of the chain with the next solution; None without a next solution."""
        if self._data is not None or self._following(self._index + 1) is None:
            return None
        following = type(self)(self._slots, self)
        following._solutions = self._solutions  # noqa: SLF001  same class
        following._index = self._index + 1  # noqa: SLF001  same class
        return following

    def resolution(self, index: int | None = None) -> Resolution:
        """Return how a solution was found, by default the designator's own."""
        if self._data is not None:
            return super().resolution(index)
        return self._solutions.resolution(self._index if index is None else index)

    @refusing("designator", name="next_solution")
    def _following(self, index: int) -> Solution | None:
        with _recorded("next_solution", self, index) as asked:
            asked.answer = solution = self._solutions.at(index)
        return solution

    def _solution(self) -> Solution:
        solution = self._solutions.at(self._index)
        if solution is None:
            raise DesignatorError(f"no resolver has a solution for {self!r}", type=self.type)
        return solution

    def _all_solutions(self) -> Iterator[Solution]:
        yield self.reference()  # the solutions can be found without further designators
        if self._data is None:
            for index in itertools.count(self._index + 1):
                solution = self._following(index)
                if solution is None:
                    return
                yield solution

    def _resolve(self) -> Iterator[tuple[Solution, str]]:
        errors: list[DesignatorError] = []
        number = 0
        admitted = forced(f"solution {self.type}", {key: value for key, value in self._slots if key != "type"})
        own = [resolver for cls in type(self).__mro__ for resolver in vars(cls).get("resolvers", ())]
        for resolver in (*own, self._own_resolver()):
            name = qualified_name(resolver)
            try:
                given = resolver(self)
                if not isinstance(given, Iterable | None) or isinstance(given, str | Mapping):
                    raise BadArgument(f"result of {name}", given, "solutions, a list of dictionaries, or None")
                for solution in given or ():
                    if not isinstance(solution, Mapping):
                        raise BadArgument(f"a solution of {name}", solution, "a dictionary")
                    number += 1
                    chosen = dict(solution) if admitted is None else admitted(number, dict(solution))
                    if chosen is not None:
                        yield chosen, name
            except DesignatorError as error:
                errors.append(error)
        if errors and not number:
            *earlier, last = errors
            if earlier and last.slot == "type":  # only a user's resolver knows this type
                earlier, last = [last, *earlier[:-1]], earlier[-1]
            raise chained(last, earlier)


class MotionDesignator(ResolvedDesignator):
    """A motion of the robot; the plan gives only some of its parameters (thesis 4.5; types in tables 4.4-4.14).

    PyCRAM's resolver knows the eleven types of the thesis; ``help(pycram.motion_designators)`` lists their slots.
    """

    @staticmethod
    def _own_resolver() -> Resolver:
        return motion_types.resolve

    def resources(self) -> Resources | None:
        """Return the parts of the robot that the motion needs, from its type; if it is effective, from its ``cmd``.

        Motions of other packages get the whole robot, unless their process module or a subclass requests less.
        """
        if self._effective and isinstance(solution := self._referenced(), Mapping):
            return motion_types.resources_of(solution)
        return motion_types.resources_by_type(self)


def unfinished(designator: Designator) -> list[str]:
    """Return the names of unfinished branches in a designator's slots that may wait for motions requested later."""
    return [branch.name for branch in designator.branches() if not branch.done and not branch.ordered]
