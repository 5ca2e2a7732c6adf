"""The plan language (thesis 3.5.3, table 3.4): which actions run concurrently, and what their failures do.

================ ============ ============================= =================================
block            branches run decided by                    fails with
================ ============ ============================= =================================
``par``          concurrently nothing: all run to their end all failures
``pursue``       concurrently the first that ends           its failure
``try_all``      concurrently the first that succeeds       all failures, if all have failed
``seq``          in order     the first that fails          its failure
``try_in_order`` in order     the first that succeeds       all failures, if all have failed
================ ============ ============================= =================================

A block can be written in these ways::

    with par as s:                       # or par()
        ProcessModule.perform(parking)   # a branch
        s(function, argument)            # a branch
        with seq:                        # a branch, whose own actions run in order
            ProcessModule.perform(moving)

    with par(failures) as s:             # collects failures in a list instead of raising; see s.state
        ...

    par(function, other)                 # the results, as a list

``docs/guides/plan_language.md`` has the rules of branches, turns, failures and cancellation. The package also has
:func:`failure_handling`, :func:`timeout` and :func:`finally_`.
"""

from __future__ import annotations

from pycram.language.block import Action, Kind, Nothing, Opening, par, pursue, seq, try_all, try_in_order
from pycram.language.nesting import finally_
from pycram.language.retries import failure_handling, retry
from pycram.language.timeouts import timeout
from pycram.scheduling.worker import in_thread
from recorder.tasks import State

__all__ = [
    "Action",
    "Kind",
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
