"""All failures, in two families: :class:`PlanFailure` (the world refused) and :class:`UsageError`."""

from pycram.foundation import failures
from pycram.foundation.failures import *  # noqa: F403  what it exports is listed there
from pycram.language.failures import BranchesFailed, NotCleanedUp, OutlivesTimeout, RunsEarly

__all__ = ["BranchesFailed", "NotCleanedUp", "OutlivesTimeout", "RunsEarly"]
__all__ += failures.__all__
