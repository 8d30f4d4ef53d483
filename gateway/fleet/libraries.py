"""Optional libraries of the fleet commands."""

from __future__ import annotations

from typing import Any

from gateway.data.extras import needed


def library(name: str) -> Any:
    """A module of the extra `fleet`; `ConfigError` where it is not installed."""
    return needed(name, "a fleet", "fleet")
