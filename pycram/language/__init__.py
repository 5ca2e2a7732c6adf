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

``docs/guides/plan_language.md`` shows how to write blocks, and has the rules of branches, failures and cancellation.
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
