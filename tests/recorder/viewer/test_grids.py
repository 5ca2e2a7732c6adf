"""Maps of places in a stranger's recording are validated, and invalid maps are refused."""

from __future__ import annotations

import math
import zlib

import numpy as np
import pytest

from recorder.records import Grid, Spot
from recorder.viewer.queries import MAX_CELLS, scores_of, spots_of


def made(**other: object) -> Grid:
    values = {
        "origin": [1.0, 2.0, 0.0],
        "resolution": 0.05,
        "width": 3,
        "height": 2,
        "scores": zlib.compress(bytes([0, 51, 255, 0, 0, 102])),
    }
    return Grid(**values | other)


def test_scores_are_rows_from_the_lowest_y() -> None:
    assert scores_of(made()).tolist() == [[0.0, 0.2, 1.0], [0.0, 0.0, 0.4]]


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"width": 0}, "0 x 2 cells"),
        ({"width": -3}, "-3 x 2 cells"),
        ({"width": 2**31 - 1, "height": 2**31 - 1}, "cells"),
        ({"width": MAX_CELLS + 1, "height": 1}, "cells"),
        ({"width": 4}, "4 x 2 cells with 6 scores"),
        ({"scores": b"no zlib"}, "can't be inflated"),
        ({"scores": b""}, "with 0 scores"),
        ({"origin": [1.0, 2.0]}, "the origin is"),
        ({"origin": [math.nan, 0.0, 0.0]}, "the origin is"),
        ({"origin": [0.0, 0.0, 1e300]}, "the origin is"),
        ({"resolution": 0.0}, "cells of 0.0 m"),
        ({"resolution": math.inf}, "cells of inf m"),
        ({"resolution": math.nan}, "cells of nan m"),
    ],
)
def test_an_impossible_map_is_refused(other: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        scores_of(made(**other))


def test_a_map_that_inflates_to_gigabytes_costs_no_more_than_its_cells() -> None:
    bomb = zlib.compress(bytes(50_000_000))
    assert scores_of(made(scores=bomb)).shape == (2, 3)


def test_places_that_are_nowhere_are_refused() -> None:
    spots = [Spot(position=[1.0, 2.0, 0.0]), Spot(position=[3.0, 4.0, 0.5])]
    assert np.array_equal(spots_of(made(spots=spots)), [[1, 2, 0], [3, 4, 0.5]])
    assert spots_of(made()).shape == (0, 3)
    for wrong in ([], [1.0, 2.0], [1.0, math.inf, 0.0], [1e9, 0.0, 0.0]):
        with pytest.raises(ValueError, match="invalid place at"):
            spots_of(made(spots=[Spot(position=wrong)]))
