"""Every motion that fails in these tests fails with what its process module declares."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.pycram.motions.declared import checked

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(autouse=True)
def only_declared_failures() -> Iterator[None]:
    """Fail the test in which a motion fails with something else."""
    with checked() as undeclared:
        yield
    assert not undeclared
