"""Collision pairs in words: which link meets which. Whoever makes them and whoever reads them says it the same way."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


def pair_text(pair: Mapping[str, object]) -> str:
    """A recorded pair as text, as "milk in the left gripper would touch sink_area_surface of kitchen".

    Args:
        pair: ``mover`` and its ``link``, the ``body`` that it would touch and its ``body_link``, and the ``gripper``
            that holds the mover; links that are the only ones, and no gripper, are "".
    """
    mover, link, body, body_link = (str(pair.get(key) or "") for key in ("mover", "link", "body", "body_link"))
    moved = f"{mover} in the {pair['gripper']} gripper" if pair.get("gripper") else link or mover
    if body == mover:
        return f"its own {moved} would touch {body_link}"
    return f"{moved} would touch {f'{body_link} of {body}' if body_link else body}"
