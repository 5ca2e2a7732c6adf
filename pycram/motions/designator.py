"""Designators: descriptions of motions, actions, objects and places, resolved late (thesis 3.5.1, 4.5, 4.6).

A designator has slots, (key, value) pairs. Resolvers find its solutions: dictionaries with all parameters. Its first
solution is its reference; its next solution is another designator with the same slots, equated to it. Equated
designators describe the same thing over time, and form a chain from the first to the current one. A designator is
*effective* once it has been referenced, or if it was made to stand for something that was found.

Designators are ``==`` only if they are identical; :meth:`Designator.equal` compares chains. Their slots never change,
so any number of threads may use a designator.
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
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeAlias, TypeVar

from pycram.foundation.errors import chained, qualified_name
from pycram.foundation.failures import BadArgument, UnknownName
from pycram.foundation.forcing import forced
from pycram.foundation.refusals import refusing
from pycram.motions import motion_types
from pycram.motions.slots import Description, DesignatorError, SolutionSlots, Value, own, pairs, same, slot_name
from pycram.reasoning.choosing import Question
from pycram.scheduling.cancellation import Binding
from pycram.scheduling.future import Future, branches_in, unwrap
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from pycram.motions.resources import Resources
    from pycram.scheduling.future import Pending


__all__ = ["Designator", "DesignatorError", "MotionDesignator", "ResolvedDesignator", "Solution"]

_chains_lock = threading.Lock()  # of all chains, because chains are joined; held for a few assignments

#: All parameters of a motion, action, object or place, by name.
Solution: TypeAlias = Mapping[str, Any]
Resolver: TypeAlias = Callable[[Any], Iterable[Solution] | None]
Function = TypeVar("Function", bound="Callable[..., object]")


class Resolvers(Generic[Function]):
    """Functions that users register, called in order until one answers; iteration goes through a snapshot."""

    def __init__(self, owner: str) -> None:
        self.owner = owner  # what they resolve, for messages
        self._lock = threading.Lock()
        self._functions: tuple[Function, ...] = ()

    def append(self, function: Function) -> Function:
        """Add a function at the end, once, and return it; also a decorator.

        Raises:
            BadArgument: It isn't callable.
        """
        if not callable(function):
            raise BadArgument(f"resolver of {self.owner}", function, "a function that takes a designator")
        with self._lock:
            if function not in self._functions:
                self._functions = (*self._functions, function)
        return function

    def remove(self, function: Function) -> None:
        """Remove a function.

        Raises:
            UnknownName: It isn't in the list.
        """
        with self._lock:
            kept = tuple(known for known in self._functions if known != function)
            if len(kept) == len(self._functions):
                raise UnknownName("resolver", qualified_name(function), self.owner, map(qualified_name, kept))
            self._functions = kept

    @contextmanager
    def added(self, function: Function) -> Iterator[Function]:
        """Add a function, not yet in the list, for the ``with`` block."""
        self.append(function)
        try:
            yield function
        finally:
            self.remove(function)

    def __iter__(self) -> Iterator[Function]:
        return iter(self._functions)

    def __len__(self) -> int:
        return len(self._functions)

    def __contains__(self, function: object) -> bool:
        return function in self._functions


@dataclass(frozen=True, slots=True)
class Resolution:
    """How a solution was found."""

    resolver: str = ""  # qualified name of the function that found it; "" for none
    index: int = 0  # index among the designator's solutions
    known: int = 1  # number of solutions found so far; others are found on request
    complete: bool = False  # whether all solutions are known


class Solutions:
    """The solutions that a designator and its successors share, in any number of threads.

    Resolvers run without a lock: they may wait for a thread that requests the same solutions. Concurrent threads each
    search, and the first to find a solution decides.

    Args:
        find: Yields the solutions, each with the name of its resolver. After a failure it is called again, and the
            known solutions are skipped.
    """

    def __init__(self, find: Callable[[], Iterator[tuple[Solution, str]]]) -> None:
        self._lock = threading.Lock()
        self._find = find
        self._rest: Iterator[tuple[Solution, str]] | None = None  # yields the solutions that aren't known yet
        self._kept: list[tuple[Solution, str]] = []
        self._complete = False

    def at(self, index: int) -> Solution | None:
        """Return the solution of an index from 0; None if there are fewer."""
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
                if len(self._kept) == count:  # no other thread was faster
                    self._rest = rest
                    self._complete = solution is None
                    if solution is not None:
                        self._kept.append(solution)

    def resolution(self, index: int) -> Resolution:
        """Return how the solution of an index was found; the resolver is "" if it wasn't."""
        with self._lock:
            resolver = self._kept[index][1] if index < len(self._kept) else ""
            return Resolution(resolver, index, len(self._kept), self._complete)


#: The designators that are carried out in this context: a motion may consist of motions.
_performed: ContextVar[tuple[Designator, ...]] = ContextVar("pycram_performed", default=())


def performing(designator: Designator) -> Binding[tuple[Designator, ...]]:
    """Treat requests of a designator in the ``with`` block as parts of performing it: they aren't recorded."""
    return Binding(_performed, (*_performed.get(), designator))


@contextmanager
def _recorded(name: str, designator: Designator, index: int | None = None) -> Iterator[Question]:
    """Record a plan's request for a solution, which the block answers.

    A UsageError is a refusal, which the caller records; other failures go into the record.

    Args:
        name: "reference" or "next_solution".
        designator: The designator.
        index: Index of the solution; by default the index of the designator's own solution.
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
    """A description of something, as slots: ``Designator([("type", "milk")])`` or ``Designator(type="milk")``.

    Args:
        description: Its slots, (key, value) pairs or a mapping. A value may be a future of a ``par`` block, or another
            designator, which is resolved when this one is.
        parent: A designator to equate it with.
        slots: Further slots; ``reachable_for`` is the slot ``reachable-for``, ``in_`` the slot ``in``.

    Raises:
        DesignatorError: The description isn't a list of pairs.
    """

    performed_by: ClassVar[str] = ""
    """Qualified name of the function that performs it; "" for ``ProcessModule.perform``."""

    @refusing("designator", name="Designator")
    def __init__(self, description: Description = (), parent: Designator | None = None, **slots: object) -> None:
        self._chain: list[Any] = [self]  # equated designators
        self._slots = pairs(description) + pairs((slot_name(name), value) for name, value in slots.items())
        self._lock = threading.Lock()
        self._effective = False
        self._data: Value = None
        self.timestamp: float | None = None  # when it became effective, in seconds since the Unix epoch
        if parent is not None:
            self.equate(parent)

    # --- slots -----------------------------------------------------------------------------------------------------

    @property
    def description(self) -> list[tuple[str, Value]]:
        """The slots as they were given."""
        return list(pairs(self._slots))

    def prop_value(self, key: str) -> Value:
        """Return a copy of a slot's value, waiting for a future's result; None if there is no such slot."""
        wanted = slot_name(key)
        return next((own(unwrap(value)) for name, value in self._slots if slot_name(name) == wanted), None)

    def check_constraints(self, properties: Iterable[str | tuple[str, object]]) -> bool:
        """Whether the slots fulfil all constraints.

        Args:
            properties: Names of slots that must have a value other than None, and (name, value) of slots that must have
                that value.
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
        """Make a solution of slots, given by name, and of other (key, value) pairs."""
        given = ((item, self.prop_value(item)) if isinstance(item, str) else item for item in properties)
        return {key: unwrap(value) for key, value in pairs(given)}

    def branches(self) -> Iterator[Pending]:
        """Yield the branches of all futures in its slots, also in designators there; don't wait."""
        for _, value in self._slots:
            yield from value.branches() if isinstance(value, Designator) else branches_in(value)

    def check(self) -> None:  # noqa: B027  most have nothing to check
        """Check its slots as far as possible without a search.

        Raises:
            UsageError: A slot is missing, unknown or wrong.
        """

    def values_for(self, slot: str, given: Mapping[str, Value]) -> Iterator[Mapping[str, Value]]:  # noqa: ARG002  for subclasses
        """Yield values for another designator's slots, for each of its own solutions.

        Args:
            slot: The slot of the other designator that has this one as its value.
            given: All slots of the other designator.

        Yields:
            Values by slot: for that slot, and for other slots that follow from it.

        Raises:
            DesignatorError: It can't be the value of a slot.
        """
        kind = type(self).__name__
        raise DesignatorError(f"a {kind} can't be the value of slot {slot}", slot=slot, value=self)

    # --- chains ------------------------------------------------------------------------------------------------------

    def equate(self, other: Self) -> None:
        """Equate this designator with another one, as the newest of the other's chain.

        Raises:
            BadArgument: The other isn't a designator.
        """
        if not isinstance(other, Designator):
            raise BadArgument("other", other, "a designator to equate with")
        with _chains_lock:
            own, theirs = self._chain, other._chain
            if own is theirs:
                return
            index = own.index(self)
            theirs[:0] = own[:index]  # its predecessors come before the other's chain
            theirs += own[index:]
            for link in own:
                link._chain = theirs  # noqa: SLF001  same class

    def chain(self) -> list[Self]:
        """Return all designators that are equated with this one, and itself, the oldest first."""
        with _chains_lock:
            return list(self._chain)

    def equal(self, other: Self) -> bool:
        """Return whether another designator is equated with this one."""
        with _chains_lock:
            return isinstance(other, Designator) and self._chain is other._chain

    def first(self) -> Self:
        """Return the oldest of the chain."""
        return self.chain()[0]

    def current(self) -> Self:
        """Return the newest of the chain."""
        return self.chain()[-1]

    def newest_effective(self) -> Designator | None:
        """Return the newest effective designator of the chain; None if there is none."""
        return next((designator for designator in reversed(self.chain()) if designator.effective), None)

    # --- solutions ---------------------------------------------------------------------------------------------------

    @property
    def effective(self) -> bool:
        """Whether it has been referenced, or made to stand for something."""
        return self._effective

    @property
    def data(self) -> Value:
        """The data of :meth:`make_effective`; None otherwise."""
        return self._data

    @abstractmethod
    def _solution(self) -> Solution:
        """Find this designator's solution, in any thread.

        Raises:
            DesignatorError: There is none.
        """

    @refusing("designator")
    def reference(self) -> Solution:
        """Return its solution, found at the first call; or the data that it was made effective with.

        Raises:
            DesignatorError: There is none.
        """
        with _recorded("reference", self) as asked:
            asked.answer = solution = self._referenced()
        return solution

    def _referenced(self) -> Solution:
        if self._data is not None:
            known: Solution = self._data
            return known
        solution = self._solution()  # the user's code: no lock is held
        with self._lock:
            self._effective = True
            if self.timestamp is None:
                self.timestamp = time.time()
        found = own(solution)
        return SolutionSlots(found) if type(found) is dict else found

    def resources(self) -> Resources | None:
        """Return its known needs of the robot; None for the whole robot. Must not wait or fail."""
        return None

    def resolution(self, index: int | None = None) -> Resolution:
        """Return how its solution, or the solution of an index, was found; the resolver is "" if it wasn't."""
        resolver = qualified_name(type(self)._solution) if self._data is None else ""  # noqa: SLF001  same class
        return Resolution(resolver, index or 0)

    def next_solution(self) -> Self | None:
        """Return an equated designator with the same slots and the solution after this one's; None if there is none."""
        return None

    def solutions(self, from_root: object = None) -> Iterator[Solution]:
        """Yield this and all further solutions, each found when needed; raise DesignatorError if there is none.

        Args:
            from_root: Anything but None or False starts with the first designator of the chain.
        """
        start = self if from_root is None or from_root is False else self.first()
        return start._all_solutions()  # noqa: SLF001  same class

    def _all_solutions(self) -> Iterator[Solution]:
        designator: Designator | None = self
        while designator is not None:
            yield designator.reference()
            designator = designator.next_solution()

    def copy(self, new_properties: Description | None = None) -> Self:
        """Return a new designator of the same kind, equated with nothing.

        Args:
            new_properties: Slots that replace those of the same name, or are appended.
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
        """Return a new effective designator, equated with this one, that stands for something found.

        Args:
            properties: Its slots; by default the slots of this designator.
            data: Its reference.
            timestamp: In seconds since the Unix epoch; now by default.
        """
        designator = type(self)(self._slots if properties is None else properties)
        designator._effective = True  # noqa: SLF001  same class
        designator._data = unwrap(data)  # noqa: SLF001  same class
        designator.timestamp = time.time() if timestamp is None else timestamp
        designator.equate(self)
        return designator

    def __reduce__(self) -> tuple[type[Designator], tuple[list[tuple[str, Value]]]]:
        """Pickle as a new designator with the same slots, which is equated with nothing."""
        return type(self), (list(self._slots),)

    def __record__(self) -> object:
        """Return its slots by name."""
        slots: dict[str, object] = {}
        for name, value in self._slots:
            slots.setdefault(name, value.__record__() if isinstance(value, Future) else value)
        return slots

    def __repr__(self) -> str:
        return f"{type(self).__name__}({list(self._slots)!r})"


class ResolvedDesignator(Designator):
    """A designator whose solutions are found by resolvers, one by one.

    A resolver takes the designator and returns solutions, a list or a generator, or None for designators of other
    types. Users add resolvers with :meth:`add_resolver`, also a decorator. They are called in order: first the
    subclass's resolvers, then its parents', then PyCRAM's own. If a resolver raises DesignatorError, the next resolver
    is called; the error is raised if none has a solution.
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
        """Return PyCRAM's own resolver; it is called last."""

    @classmethod
    def add_resolver(cls, resolver: Resolver) -> Resolver:
        """Add a resolver for this class and its subclasses, once, after the earlier resolvers; return it."""
        return cls.resolvers.append(resolver)

    @classmethod
    def remove_resolver(cls, resolver: Resolver) -> None:
        """Remove a resolver that was added to this class.

        Raises:
            UnknownName: The resolver wasn't added to this class.
        """
        cls.resolvers.remove(resolver)

    @property
    def type(self) -> str:
        """The value of its slot ``type``, "" if it has none."""
        value = self.prop_value("type")
        return value if isinstance(value, str) else ""

    def next_solution(self) -> Self | None:
        """Return an equated designator with the next solution; None if there is none."""
        if self._data is not None or self._following(self._index + 1) is None:
            return None
        following = type(self)(self._slots, self)
        following._solutions = self._solutions  # noqa: SLF001  same class
        following._index = self._index + 1  # noqa: SLF001  same class
        return following

    def resolution(self, index: int | None = None) -> Resolution:
        """Return how its solution, or the solution of an index, was found."""
        if self._data is not None:
            return super().resolution(index)
        return self._solutions.resolution(self._index if index is None else index)

    @refusing("designator", name="next_solution")
    def _following(self, index: int) -> Solution | None:
        """Return a later solution for the plan; None if there is none."""
        with _recorded("next_solution", self, index) as asked:
            asked.answer = solution = self._solutions.at(index)
        return solution

    def _solution(self) -> Solution:
        solution = self._solutions.at(self._index)
        if solution is None:
            raise DesignatorError(f"no resolver has a solution for {self!r}", type=self.type)
        return solution

    def _all_solutions(self) -> Iterator[Solution]:
        yield self.reference()  # without a designator for each further solution
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
            if earlier and last.slot == "type":  # only a resolver of the user's knows this type
                earlier, last = [last, *earlier[:-1]], earlier[-1]
            raise chained(last, earlier)


class MotionDesignator(ResolvedDesignator):
    """A motion of the robot, with the parameters that the plan cares about (thesis 4.5; types in tables 4.4-4.14).

    PyCRAM's own resolver knows the eleven types of the thesis; ``help(pycram.motion_designators)`` lists their slots.
    """

    @staticmethod
    def _own_resolver() -> Resolver:
        return motion_types.resolve

    def resources(self) -> Resources | None:
        """Return its needs of the robot: by its type, and once it is effective, by the ``cmd`` of its solution.

        Motions of other packages get the whole robot, unless their process module or a subclass returns less.
        """
        if self._effective and isinstance(solution := self._referenced(), Mapping):
            return motion_types.resources_of(solution)
        return motion_types.resources_by_type(self)


def unfinished(designator: Designator) -> list[str]:
    """Return the names of running branches in a designator's slots that may wait for later requests."""
    return [branch.name for branch in designator.branches() if not branch.done and not branch.ordered]
