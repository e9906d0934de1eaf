"""Worlds by name, as the command line and reports call them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from revnm_client.errors import ConfigError
from revnm_sim.generation.aisles import aisles
from revnm_sim.generation.generator import demo_room, random_pillar
from revnm_sim.generation.rooms import rooms
from revnm_sim.generation.slits import slits
from revnm_sim.site import Site
from revnm_sim.world import World
from revnm_sim.world_file import load_site

_GENERATED: Mapping[str, Callable[[int], World]] = MappingProxyType(
    {"random_pillar": random_pillar, "demo_room": demo_room, "slits": slits, "aisles": aisles, "rooms": rooms}
)
_SCENES = ("bookstore", "warehouse")
WORLDS = (*_GENERATED, *_SCENES)


def named_site(name_or_path: str, seed: int) -> Site:
    """Return the site of a name, or of a path to a world file.

    Args:
        name_or_path: One of :data:`WORLDS`; or a path: what has a separator in it, or ends in .yaml or .yml.
        seed: Which world of a generated family; worlds from files do not depend on it.

    Raises:
        ConfigError: No world has this name, or the seed of a generated world is negative.
        FileError: The world file cannot be read or is malformed.
    """
    if is_generated(name_or_path):
        return Site(generated_world(name_or_path, seed), f"world {name_or_path}, seed {seed}")
    if name_or_path in _SCENES:
        return load_site(Path(__file__).parent / "scenes" / f"{name_or_path}.yaml")
    if os.sep in name_or_path or name_or_path.endswith((".yaml", ".yml")):
        return load_site(Path(name_or_path))
    raise ConfigError(
        f"no world is named {name_or_path!r}: expected one of {', '.join(sorted(WORLDS))}, or a path to a .yaml file"
    )


def generated_world(family: str, seed: int) -> World:
    """Return a world of a family for which :func:`is_generated` holds.

    Raises:
        ConfigError: The seed is negative.
    """
    return _GENERATED[family](seed)


def is_generated(name: str) -> bool:
    """Tell whether a name is that of a family of worlds made by seed."""
    return name in _GENERATED
