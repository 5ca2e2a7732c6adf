"""Why a plan failed: what can be found out of its recording (:mod:`~replay.why.inquiry`), and how that is told."""

from replay.why.explanation import Asked, Since, Thing, Try, Why
from replay.why.inquiry import why

__all__ = ["Asked", "Since", "Thing", "Try", "Why", "why"]
