"""Compares nested data number by number."""

from __future__ import annotations


def assert_approximately(found: object, wanted: object, where: str = "", within: float = 1e-9) -> None:
    """Assert equal keys and strings, and numbers that differ by no more than ``within``."""
    if isinstance(wanted, dict):
        assert isinstance(found, dict), where
        assert sorted(found) == sorted(wanted), where
        for key, value in wanted.items():
            assert_approximately(found[key], value, f"{where}/{key}", within)
    elif isinstance(wanted, list | tuple) and isinstance(found, list | tuple):
        assert len(found) == len(wanted), where
        for a, b in zip(found, wanted, strict=True):
            assert_approximately(a, b, where, within)
    elif isinstance(wanted, float) and isinstance(found, float | int):
        assert abs(found - wanted) <= within, where
    else:
        assert found == wanted, where
