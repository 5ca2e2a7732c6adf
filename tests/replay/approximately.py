"""Compares nested data number by number."""

from __future__ import annotations


def assert_approximately(actual: object, wanted: object, where: str = "", within: float = 1e-9) -> None:
    """Assert equal keys and strings, and numbers that differ by no more than ``within``."""
    if isinstance(wanted, dict):
        assert isinstance(actual, dict), where
        assert sorted(actual) == sorted(wanted), where
        for key, value in wanted.items():
            assert_approximately(actual[key], value, f"{where}/{key}", within)
    elif isinstance(wanted, list | tuple) and isinstance(actual, list | tuple):
        assert len(actual) == len(wanted), where
        for a, b in zip(actual, wanted, strict=True):
            assert_approximately(a, b, where, within)
    elif isinstance(wanted, float) and isinstance(actual, float | int):
        assert abs(actual - wanted) <= within, where
    else:
        assert actual == wanted, where
