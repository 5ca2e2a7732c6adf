"""All failures, in two families: :class:`PlanFailure` (the world prevents an action) and :class:`UsageError`."""

from pycram.foundation import failures
from pycram.foundation.errors import *  # noqa: F403  the module lists its exports
from pycram.foundation.failures import *  # noqa: F403  the module lists its exports, with those of errors.py
from pycram.language.failures import BranchesFailed, NotCleanedUp, OutlivesTimeout, RunsEarly
from pycram.scheduling.order import DeadlockedBranches

__all__ = ["BranchesFailed", "DeadlockedBranches", "NotCleanedUp", "OutlivesTimeout", "RunsEarly"]
__all__ += failures.__all__
