"""A run notes the functions and arguments that it computed, so that another process can compute them."""

from __future__ import annotations

import pytest

from pycram.models import load, rigid_parts, shapes, warming
from recorder import urdf


@pytest.mark.slow
def test_warming_computes_what_was_noted() -> None:
    cached = (load._cached_model, shapes._read, shapes.solids_of, rigid_parts.divided, urdf._parse)

    def forget() -> None:
        for each in cached:
            each.cache_clear()

    def compute() -> None:
        model = load.load("table.urdf")
        shapes.solids_of(model.path)
        rigid_parts.divided(model.path)
        urdf.Urdf.parse(model.path.read_bytes())  # as the recording does

    forget()
    with warming.noted() as notes:
        compute()
    text = notes.text()
    forget()
    warming.warm(text)
    before = [each.cache_info().misses for each in cached]
    assert all(before)
    compute()
    assert [each.cache_info().misses for each in cached] == before


def test_unknown_modules_and_functions_are_skipped() -> None:
    notes = warming.Notes([("pycram.models.load", "no_such_function", ()), ("no_such_module", "f", ())])
    warming.warm(notes.text())
