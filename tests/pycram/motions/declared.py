"""What motions raise while tests of motions run is what their process modules declare."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pycram.foundation import failures
from pycram.motions.process_module import ProcessModule

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.motions.designator import Designator
    from pycram.motions.process_module import SimulatedModule

_OURS = "pycram.motions.modules."


@contextmanager
def checked() -> Iterator[list[str]]:
    """Note the failures that PyCRAM's process modules raise in the ``with`` block without declaring them."""
    undeclared: list[str] = []
    execute = ProcessModule.execute

    def observed(module: SimulatedModule, designator: Designator) -> Any:
        try:
            return execute(module, designator)
        except failures.PlanFailure as failure:
            own = type(module).__module__.startswith(_OURS) and type(failure).__name__ in failures.__all__
            if own and type(failure) not in (*module.failures, *module.failures_in_time):
                undeclared.append(f"{type(module).__name__}: {failure!r}")
            raise

    ProcessModule.execute = observed  # type: ignore[method-assign, assignment]
    try:
        yield undeclared
    finally:
        ProcessModule.execute = execute  # type: ignore[method-assign]
