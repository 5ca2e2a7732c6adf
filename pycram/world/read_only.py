"""Public attributes that only transactions change: plans read them, and an assignment names the method to use."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from pycram.foundation.failures import ReadOnly
from pycram.foundation.refusals import refused

if TYPE_CHECKING:
    from collections.abc import Mapping

_NOTHING: frozenset[str] = frozenset()


class ReadOnlyAttributes:
    """Refuses assignments to its public attributes and methods from :meth:`_seal` on; setters go on working.

    Attributes of a plan's own, and of subclasses, may be added and assigned.
    """

    _SUBJECT: ClassVar[str]  # what records call it
    _CHANGED_BY: ClassVar[Mapping[str, str]]  # what to do instead, by attribute; "" for the others
    _sealed: frozenset[str] = _NOTHING

    def _seal(self, kind: type) -> None:
        """Make what its constructor has set read-only, and what the class defines."""
        settable = {name for name, member in vars(kind).items() if isinstance(member, property) and member.fset}
        self._sealed = frozenset(name for name in (vars(self).keys() | vars(kind).keys()) - settable if name[0] != "_")

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute.

        Raises:
            ReadOnly: Only transactions change it.
        """
        if name in self._sealed:
            raise self._refused(name, f"{name} = ...", {"value": value})
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        """Delete an attribute.

        Raises:
            ReadOnly: Only transactions change it.
        """
        if name in self._sealed:
            raise self._refused(name, f"del {name}", {})
        super().__delattr__(name)

    def _refused(self, name: str, called: str, arguments: Mapping[str, object]) -> ReadOnly:
        instead = self._CHANGED_BY.get(name) or self._CHANGED_BY[""]
        return refused(ReadOnly(repr(self), name, instead), called, {self._SUBJECT: self, **arguments})


def update(owner: ReadOnlyAttributes, **values: object) -> None:
    """Set read-only attributes: for transactions, which also record what they change."""
    vars(owner).update(values)
