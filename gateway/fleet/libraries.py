"""Optional libraries of the fleet commands."""

from __future__ import annotations

from typing import Any

from gateway.data.extras import needed


def library(name: str) -> Any:
    """Import a module of the extra `fleet`; raise `ConfigError` if it is not installed."""
    return needed(name, "a fleet", "fleet")
