"""No test of the scheduler hangs, or leaves anything running."""

from tests.pycram.language.conftest import _watched  # noqa: F401  the same holds for the plan language
