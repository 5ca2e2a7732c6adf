"""Opens recordings: any step back, from the file alone.

``replay.open(path)`` gives the records by step; ``replay.state_at(log, step)`` what was true after one.
"""

from replay.errors import NoSuchStep, NotALog, ReplayError
from replay.fold import state_at
from replay.log import Log
from replay.log import open_log as open  # noqa: A004  replay.open reads well
from replay.state import State

__all__ = ["Log", "NoSuchStep", "NotALog", "ReplayError", "State", "open", "state_at"]
