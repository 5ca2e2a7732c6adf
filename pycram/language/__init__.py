"""The plan language (thesis 3.5.3, table 3.4): what runs at the same time, and what becomes of failures.

================ ========== =========================================== ===========================================
block            branches   is decided by                               fails with
================ ========== =========================================== ===========================================
``par``          at once    nothing: all run to their end               the failures of all that failed
``pursue``       at once    the first that ends, well or badly          the failure of that one
``try_all``      at once    the first that succeeds                     the failures of all, when all have failed
``seq``          in order   the first that fails                        the failure of that one
``try_in_order`` in order   the first that succeeds                     the failures of all, when all have failed
================ ========== =========================================== ===========================================

Each can be written in four ways::

    with par as s:                       # or par()
        ProcessModule.perform(parking)   # a branch
        s(function, argument)            # another one
        with seq:                        # a third one, in which things happen in order
            ProcessModule.perform(moving)
            ProcessModule.perform(looking)

    with par(failures) as s:             # failures go into a list; s.state tells whether there were any
        ...

    par(function, other)                 # the results, as a list

Each action, each block in the body and each ``s(...)`` is a branch. In a concurrent block and in ``try_in_order`` it
gives a future that serves as its result (:mod:`pycram.scheduling.future`). In ``seq`` a failure rises through the body
as in plain Python, which may handle it. A block that is decided tells its other branches to stop: they do so at their
next action or wait, and the block ends when all of them have. An empty block succeeds. A failure in the body ends the
body; it decides ``pursue``, and is one more of the failures elsewhere.

A failed block raises :class:`~pycram.failures.BranchesFailed` with all failures; usage errors come out as they are. A
block, a timeout, an attempt or a cleanup ends where it began, in the order of ``with`` statements
(:mod:`pycram.language.nesting`): a generator may yield in its body only to what is over when the generator goes on, as
that of a context manager does. Branches that need the same part of the robot queue in the order in which they are asked
for (:mod:`pycram.motions.resources`).

One branch runs at a time, and goes on until its next motion, wait or change of a world, where the next one takes its
turn: the same plan takes the same order each time (:mod:`pycram.scheduling`). What blocks outside of PyCRAM, such as
``time.sleep`` or a socket, blocks all branches; ``in_thread(time.sleep, 3)`` does not.
"""

from __future__ import annotations

from pycram.language.attempts import retry
from pycram.language.cleanup import finally_
from pycram.language.retries import failure_handling
from pycram.language.timeouts import timeout
from pycram.language.words import (
    Action,
    Collecting,
    Kind,
    NeverOpened,
    Nothing,
    Opening,
    par,
    pursue,
    seq,
    try_all,
    try_in_order,
)
from pycram.scheduling.worker import in_thread
from recorder.tasks import State

__all__ = [
    "Action",
    "Collecting",
    "Kind",
    "NeverOpened",
    "Nothing",
    "Opening",
    "State",
    "failure_handling",
    "finally_",
    "in_thread",
    "par",
    "pursue",
    "retry",
    "seq",
    "timeout",
    "try_all",
    "try_in_order",
]
