"""Designators: descriptions of what a plan wants, resolved to parameters as late as possible (thesis 3.5.1, 4.5, 4.6).

A designator is a list of slots, (key, value) pairs. Referencing it finds its solutions: dictionaries with all that is
needed to act. Its first solution is its reference; its next solution is another designator with the same slots, equated
to it. Designators that are equated describe the same thing, over time; they form a chain from the first to the current
one. A designator is *effective* once it has been referenced, or when it was made to stand for something that was found.

Two designators are ``==`` only if they are one and the same; :meth:`Designator.equal` tells whether they are equated.
The slots never change, so that a designator may be used by any number of threads; lists among them are its own.
"""

from __future__ import annotations

import itertools
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar, TypeAlias

from pycram.foundation.error_chain import chained
from pycram.foundation.failures import BadArgument
from pycram.foundation.names import qualified_name
from pycram.motions import motion_types
from pycram.motions.equated import Equated
from pycram.motions.resolvers import Resolvers
from pycram.motions.slots import Description, DesignatorError, Value, own, pairs, same
from pycram.motions.solutions import Solution, Solutions
from pycram.scheduling.future import Future, branches_in, unwrap

if TYPE_CHECKING:
    from typing import Self

    from pycram.motions.resources import Resources

__all__ = ["Designator", "DesignatorError", "MotionDesignator", "Solution"]


class Designator(Equated, ABC):
    """A description of something, as a list of slots.

    Attributes:
        timestamp: when it became effective, in seconds since the Unix epoch; None as long as it isn't.
    """

    def __init__(self, description: Description, parent: Designator | None = None) -> None:
        """Makes a designator.

        Args:
            description: its slots, a list of (key, value) or a mapping. A value may be the handle that ``perform``
                gives in a ``par`` block; it stands for its result.
            parent: the designator to equate it with.

        Raises:
            DesignatorError: the description isn't that.
        """
        super().__init__()
        self._slots = pairs(description)
        self._lock = threading.Lock()
        self._effective = False
        self._data: Value = None
        self.timestamp: float | None = None
        if parent is not None:
            self.equate(parent)

    # --- slots -----------------------------------------------------------------------------------------------------

    @property
    def description(self) -> list[tuple[str, Value]]:
        """The slots as they were given."""
        return list(pairs(self._slots))

    def prop_value(self, key: str) -> Value:
        """The value of a slot.

        Args:
            key: its name.

        Returns:
            The value, the result where it is a handle (waits for it); None if there is no such slot.
        """
        return next((own(unwrap(value)) for name, value in self._slots if name == key), None)

    def check_constraints(self, properties: Iterable[str | tuple[str, object]]) -> bool:
        """Whether the slots are as asked.

        Args:
            properties: names of slots that must be there with a value other than None, and (name, value) of slots that
                must have just that value.

        Returns:
            Whether all of that is so.
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
        """A solution, from slots and other values.

        Args:
            properties: names of slots to take over, and (key, value) to put in.

        Returns:
            A dictionary with all of these.
        """
        given = ((item, self.prop_value(item)) if isinstance(item, str) else item for item in properties)
        return {key: unwrap(value) for key, value in pairs(given)}

    def newest_effective(self) -> Designator | None:
        """The newest effective designator among those equated with this one; None if there is none."""
        return next((one for one in reversed(self.chain()) if one.effective), None)

    @property
    def effective(self) -> bool:
        """Whether it has been referenced, or made to stand for something."""
        return self._effective

    @property
    def data(self) -> Value:
        """What it was made effective with; None otherwise."""
        return self._data

    # --- solutions ---------------------------------------------------------------------------------------------------

    @abstractmethod
    def _solution(self) -> Solution:
        """Finds this designator's solution, in any thread.

        Raises:
            DesignatorError: there is none.
        """

    def reference(self) -> Solution:
        """Its solution: found when it is asked for the first time, and the same ever after.

        Returns:
            All parameters by name; what it was made effective with, if it was.

        Raises:
            DesignatorError: there is none.
        """
        if self._data is not None:
            solution: Solution = self._data
            return solution
        solution = self._solution()  # the user's code: no lock is held
        with self._lock:
            self._effective = True
            if self.timestamp is None:
                self.timestamp = time.time()
        return own(solution)

    def resources(self) -> Resources | None:
        """What it needs of the robot, as far as that is known by now. Never waits, never fails.

        Returns:
            The resources; None if nobody knows: it gets all that there is.
        """
        return None

    def next_solution(self) -> Self | None:
        """Another solution.

        Returns:
            A new designator with the same slots that is equated with this one and refers to the solution after this
            one's; None if there is no other.
        """
        return None

    def solutions(self, from_root: object = None) -> Iterator[Solution]:
        """All solutions from this one's on, each found when it is asked for.

        Args:
            from_root: anything but None or False begins with the first of the equated designators.

        Returns:
            An iterator; it raises DesignatorError if there is no solution at all.
        """
        one = self if from_root is None or from_root is False else self.first()
        return one._all_solutions()  # noqa: SLF001  same class

    def _all_solutions(self) -> Iterator[Solution]:
        one: Designator | None = self
        while one is not None:
            yield one.reference()
            one = one.next_solution()

    def copy(self, new_properties: Description | None = None) -> Self:
        """A new designator of the same kind, equated with nothing.

        Args:
            new_properties: slots that replace those of the same name, or come after the others.

        Returns:
            The new one.
        """
        slots = list(self._slots)
        for key, value in pairs(new_properties or ()):
            places = [place for place, (name, _) in enumerate(slots) if name == key]
            for place in places:
                slots[place] = (key, value)
            if not places:
                slots.append((key, value))
        return type(self)(slots)

    def make_effective(
        self, properties: Description | None = None, data: Value = None, timestamp: float | None = None
    ) -> Self:
        """A new designator, equated with this one, that stands for what was found or became true.

        Args:
            properties: its slots; this one's by default.
            data: what it stands for; its reference.
            timestamp: when that was so, in seconds since the Unix epoch; now by default.

        Returns:
            The new one, effective.
        """
        made = type(self)(self._slots if properties is None else properties)
        made._effective = True  # noqa: SLF001  same class
        made._data = unwrap(data)  # noqa: SLF001  same class
        made.timestamp = time.time() if timestamp is None else timestamp
        made.equate(self)
        return made

    def __record__(self) -> object:
        """Its slots by name."""
        slots: dict[str, object] = {}
        for name, value in self._slots:
            slots.setdefault(name, value.__record__() if isinstance(value, Future) else value)
        return slots

    def __repr__(self) -> str:
        return f"{type(self).__name__}({list(self._slots)!r})"


Resolver: TypeAlias = Callable[["MotionDesignator"], Iterable[Solution] | None]


class MotionDesignator(Designator):
    """A motion of the robot, with the parameters that the plan cares about (thesis 4.5; types in tables 4.4-4.14).

    Resolvers find the solutions: functions that take the designator and give solutions, a list or a generator, none at
    all if it isn't theirs. Users add theirs with :meth:`add_resolver`, a decorator too, and take them back with
    :meth:`remove_resolver`. They are asked in order; PyCRAM's own, which knows the eleven types of the
    thesis, comes last. Each subclass has a list of its own, which is asked before its parents'. A resolver that raises
    DesignatorError doesn't take the designator; the error comes out when no resolver has a solution.
    """

    resolvers: ClassVar[Resolvers[Resolver]] = Resolvers("motion designators")

    def __init_subclass__(cls, **kwargs: object) -> None:
        """Gives a subclass its own resolvers."""
        super().__init_subclass__(**kwargs)
        cls.resolvers = Resolvers(cls.__name__)

    def __init__(self, description: Description, parent: Designator | None = None) -> None:
        """Makes a designator; see :class:`Designator`."""
        super().__init__(description, parent)
        self._solutions = Solutions(self._resolve)
        self._index = 0

    @classmethod
    def add_resolver(cls, resolver: Resolver) -> Resolver:
        """Adds a resolver for this class and its subclasses, after those that were added before.

        Args:
            resolver: gives solutions for a designator; the same one counts once.

        Returns:
            The resolver.
        """
        return cls.resolvers.append(resolver)

    @classmethod
    def remove_resolver(cls, resolver: Resolver) -> None:
        """Removes a resolver.

        Args:
            resolver: one that was added to this class.

        Raises:
            UnknownName: it wasn't.
        """
        cls.resolvers.remove(resolver)

    @property
    def type(self) -> str:
        """The value of its slot ``type``, "" if it has none."""
        value = self.prop_value("type")
        return value if isinstance(value, str) else ""

    def resources(self) -> Resources | None:
        """What it needs of the robot: by the ``cmd`` of its solution once that is found, before that by its type.

        Only PyCRAM's own are known; others get the whole robot, and their process module may make that less. A
        subclass that says here what it needs has it from the moment in which it is asked for.
        """
        if self.effective and isinstance(solution := self.reference(), Mapping):
            return motion_types.resources_of(solution)
        return motion_types.resources_by_type(self)

    def next_solution(self) -> Self | None:
        """Another solution; see :meth:`Designator.next_solution`."""
        if self._data is not None or self._solutions.at(self._index + 1) is None:
            return None
        other = type(self)(self._slots, self)
        other._solutions = self._solutions  # noqa: SLF001  same class
        other._index = self._index + 1  # noqa: SLF001  same class
        return other

    def _solution(self) -> Solution:
        solution = self._solutions.at(self._index)
        if solution is None:
            raise DesignatorError(f"no resolver has a solution for {self!r}", type=self.type)
        return solution

    def _all_solutions(self) -> Iterator[Solution]:
        yield self.reference()  # the others are looked up without making a designator for each
        if self._data is None:
            for index in itertools.count(self._index + 1):
                solution = self._solutions.at(index)
                if solution is None:
                    return
                yield solution

    def _resolve(self) -> Iterator[Solution]:
        errors: list[DesignatorError] = []
        found = False
        own = [resolver for cls in type(self).__mro__ for resolver in vars(cls).get("resolvers", ())]
        for resolver in (*own, motion_types.resolve):
            try:
                for solution in _solutions_of(resolver, self):
                    found = True
                    yield dict(solution)
            except DesignatorError as error:
                errors.append(error)
        if errors and not found:
            raise chained(errors[-1], errors[:-1])


def _solutions_of(resolver: Resolver, designator: MotionDesignator) -> Iterator[Solution]:
    given = resolver(designator)
    if not isinstance(given, Iterable | None) or isinstance(given, str | Mapping):
        raise BadArgument(f"what {qualified_name(resolver)} gave", given, "solutions, a list of dictionaries, or None")
    for solution in given or ():
        if not isinstance(solution, Mapping):
            raise BadArgument(f"a solution of {qualified_name(resolver)}", solution, "a dictionary")
        yield solution


def unfinished(designator: Designator) -> list[str]:
    """Names of the branches that a designator waits for and that wait themselves for who knows what.

    Args:
        designator: any.

    Returns:
        The branches among its slots that have not ended and may come to wait for something that is asked for later.
    """
    branches = branches_in([value for _, value in designator.description])
    return [branch.name for branch in branches if not branch.done and not branch.ordered]
