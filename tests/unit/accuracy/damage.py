"""Damage to the product on purpose, as functions of pytest's monkeypatch."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import pytest

Damage = Callable[[pytest.MonkeyPatch], None]


def breaks(name: str, *owners: Any) -> Callable[[Callable[..., Any]], Damage]:
    """Puts the decorated function in the place of `name` of modules or classes; its first argument is the original."""

    def decorate(changed: Callable[..., Any]) -> Damage:
        @wraps(changed)
        def apply(patch: pytest.MonkeyPatch) -> None:
            for owner in owners:
                true = getattr(owner, name)
                patch.setattr(owner, name, lambda *given, true=true, **named: changed(true, *given, **named))

        return apply

    return decorate
