"""What a run has computed of models can be computed once for all: its notes name the functions and their arguments."""

from __future__ import annotations

import pytest

from pycram.models import load, rigid_parts, shapes, warming
from recorder import urdf


@pytest.mark.slow
def test_what_was_noted_is_found_done() -> None:
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


def test_what_is_no_module_any_more_is_left_out() -> None:
    notes = warming.Notes([("pycram.models.load", "no_such_function", ()), ("no_such_module", "f", ())])
    warming.warm(notes.text())
