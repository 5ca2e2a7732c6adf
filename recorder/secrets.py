"""Names that say that a value is secret: such values are left out of recordings."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

LEFT_OUT: Final = "<left out>"

_SECRET: Final = frozenset(
    word + plural
    for word in ("password", "passphrase", "passwd", "pwd", "secret", "token", "key", "apikey", "credential")
    for plural in ("", "s")
)
_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


@lru_cache(maxsize=4096)
def is_secret(name: str) -> bool:
    """Whether a word of a name (``api_key``, ``apiKey``, ``API-KEY``) says that its value is secret."""
    return any(word.lower() in _SECRET for word in _WORDS.findall(name))


def without_secrets(arguments: Sequence[str]) -> list[str]:
    """A command line without the values of options that are named like secrets: ``--token X``, ``--token=X``."""
    kept: list[str] = []
    secret = False
    for text in arguments:
        option, equals, _ = text.partition("=")
        if secret and not text.startswith("-"):
            kept.append(LEFT_OUT)
        elif equals and is_secret(option):
            kept.append(f"{option}={LEFT_OUT}")
        else:
            kept.append(text)
        secret = not equals and text.startswith("-") and is_secret(option)
    return kept
