"""Worlds by name, as the command line and reports call them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from revnm_client.errors import ConfigError
from revnm_sim.generator import demo_room, random_pillar
from revnm_sim.world import World

WORLDS: Mapping[str, Callable[[int], World]] = MappingProxyType(
    {"random_pillar": random_pillar, "demo_room": demo_room}
)


def named_world(name: str, seed: int) -> World:
    """Return a world; generated ones differ by seed.

    Raises:
        ConfigError: No world has this name, or the seed is negative.
    """
    if name not in WORLDS:
        raise ConfigError(f"no world is named {name!r}: expected one of {', '.join(sorted(WORLDS))}")
    return WORLDS[name](seed)
