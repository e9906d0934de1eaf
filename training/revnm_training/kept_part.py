"""A network of an existing bundle, for another bundle that takes it over as it is."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from revnm_client.errors import FileError
from revnm_server.networks.bundle import load_bundle, load_depth_bundle
from revnm_server.networks.manifest import MANIFEST
from revnm_training.preset import DepthConfig, Preset, depth_config_from

_NEEDED = {"depth": ("disparity_hw",)}
"""Parts of the observation that must be equal, by kind; of the others all."""


@dataclass(frozen=True, slots=True)
class KeptPart:
    """One network.

    Attributes:
        path: Its ONNX file.
        encoder: That of the policy's encoder, where the policy is in two parts.
        disparity_hw: Of the bundle's depth network.
        depth: Sizes of that network, where the bundle tells them.
        entry: Of the manifest's ``models``.
        run: How it was trained, as of the manifest.
        data: On what.
        validation: With what result.
    """

    path: Path
    encoder: Path | None
    disparity_hw: tuple[int, int]
    depth: DepthConfig | None
    entry: dict[str, Any]
    run: dict[str, Any]
    data: dict[str, Any]
    validation: dict[str, Any]


def kept_part(base: Path, kind: str, preset: Preset) -> KeptPart:
    """Return a network of a bundle.

    Args:
        base: Folder of the bundle.
        kind: ``policy``, ``exo2ego`` or ``depth``.
        preset: What it must fit. Where that has no depth network, any bundle's does.

    Raises:
        FileError: The bundle is malformed, lacks the network, or was made for another observation.
    """
    load = load_depth_bundle if kind == "depth" else load_bundle
    bundle = load(base, threads=1)  # checks files and hashes
    manifest = json.loads((base / MANIFEST).read_text(encoding="utf-8"))
    if kind not in manifest["models"]:
        raise FileError(f"{base / MANIFEST}: models: has no {kind} network to take over")
    asked = json.loads(json.dumps(asdict(preset.observation)))
    needed = () if kind == "depth" and preset.depth is None else _NEEDED.get(kind, tuple(asked))
    for name in needed:
        if manifest["observation"][name] != asked[name]:
            raise FileError(
                f"{base / MANIFEST}: observation.{name} is {manifest['observation'][name]}, "
                f"but preset {preset.name!r} has {asked[name]}: its {kind} network does not fit"
            )
    entry = manifest["models"][kind]
    encoder = entry.get("encoder")
    return KeptPart(
        base / entry["file"],
        base / encoder["file"] if encoder else None,
        bundle.spec.disparity_hw,
        depth_config_from(manifest["recipe"].get("preset", {}).get("depth"), f"{base / MANIFEST}: recipe.preset.depth"),
        entry,
        manifest["recipe"]["runs"].get(kind, {}),
        manifest["data"].get(kind, {}),
        manifest["results"]["validation"].get(kind, {}),
    )
