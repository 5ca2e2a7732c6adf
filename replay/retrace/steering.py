"""Makes the changes of a fork in the process of its plan, each after its step.

A step's record is made in the middle of what it tells. So a change waits until that is done: until the main thread
has no section open that mustn't be interrupted and holds no lock, and what a world calls when its lock is free has been
called. The plan can't have seen anything of the world since. It is made outside of the plan's tasks, blocks and
branches, by the setters that plans call, and its record says that it isn't the plan's.
"""

from __future__ import annotations

import threading
from contextvars import Context
from typing import TYPE_CHECKING

from pycram.scheduling.locks import is_held
from pycram.world.current import open_worlds
from recorder.records import Fluent, Mutation, Query
from recorder.tracing import interrupts, journal
from recorder.tracing.process_identity import process
from replay.retrace.answers import parse_answer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import NoReturn

    from recorder.records import Change, Record
    from replay.retrace.answers import Answers


class Steering:
    """Makes changes when their steps have passed.

    Args:
        changes: all, in order.
        answers: is told those that are answers.
        make: makes another one.
        refuse: called with the error of one that can't be made; it doesn't return.

    Attributes:
        due: those whose step has passed, and which aren't made yet.
    """

    def __init__(
        self,
        changes: Sequence[Change],
        answers: Answers,
        make: Callable[[Change], None],
        refuse: Callable[[Exception], NoReturn],
    ) -> None:
        self._changes = changes
        self._answers = answers
        self._make = make
        self._refuse = refuse
        self._process = process()
        self._making = False
        self._done: Callable[[], None] | None = None
        self.due: list[Change] = []

    def passed(self, step: int, done: Callable[[], None]) -> None:
        """Take note that a step's record is made; ``done`` is called when nothing is due any more."""
        for change in self._changes:
            if change.step == step and change.answer:
                self._answers.given.append(parse_answer(change.answer))
            elif change.step == step:
                self.due.append(change)
        if not self.due:
            done()
            return
        self._done = done
        interrupts.call_soon(self._try)

    def complete(self, record: Record) -> None:
        """Complete a record that is being made: it tells what whoever forked the run did."""
        if isinstance(record, Query):
            self._answers.complete(record)
        elif self._making and isinstance(record, Mutation | Fluent) and not record.task and not record.cause:
            is_set = isinstance(record, Mutation) or not record.source  # others follow the world
            record.by_fork = is_set and threading.current_thread() is threading.main_thread()

    def _try(self) -> bool:
        """Make what is due, if that can be done now; return whether it needn't be tried again."""
        if process() != self._process:  # a projection: it ends before that
            return True
        if is_held():
            world = next((each for each in open_worlds() if each.lock.is_mine), None)
            if world is not None:
                world.lock.defer([self._try_again])
            return world is not None
        if not journal.recording():
            return False
        due, self.due = self.due, []
        self._making = True
        try:
            for change in due:
                Context().run(self._make, change)
        except Exception as error:  # noqa: BLE001  the setter's, or a handler's of the plan
            self._refuse(error)
        finally:
            self._making = False
        if self._done is not None:
            self._done()
        return True

    def _try_again(self) -> None:
        if not self._try():
            interrupts.call_soon(self._try)
