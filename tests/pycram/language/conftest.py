"""No test of the plan language hangs, or leaves anything running."""

from __future__ import annotations

import faulthandler
import threading
from typing import TYPE_CHECKING

import pytest

from pycram import tasks
from pycram.scheduling.schedule import scheduler

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(autouse=True)
def _watched() -> Iterator[None]:
    """Nothing hangs, no branch or worker outlives its block, and no task stays running in the task tree."""
    faulthandler.dump_traceback_later(300, exit=True)  # a busy machine may take a while
    before = threading.active_count()
    yield
    faulthandler.cancel_dump_traceback_later()
    assert threading.active_count() == before
    assert not scheduler().branches
    assert all(node.finished for node in tasks.tree().nodes.values())
