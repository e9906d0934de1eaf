"""What a record says of the server that made it: enough to make the same plans again, and nothing that is secret."""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any

from revnm_server.camera.url import redact
from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.manifest import MANIFEST
from revnm_server.report import installed_versions
from revnm_server.settings import Settings

FORMAT = "revnm run record 1"

_PACKAGES = ("revnm-server", "revnm-client", "numpy", "scipy", "onnxruntime", "opencv-python-headless", "eclipse-zenoh")


def describe(settings: Settings, bundle: Path) -> dict[str, str]:
    """Return what every file of a record begins with.

    Args:
        settings: The server's; of these only sections that hold no secrets are told.
        bundle: Folder of the models.
    """
    told: dict[str, Any] = {
        "camera": {"name": settings.camera.name, "url": redact(settings.camera.url)},
        "perception": settings.perception.model_dump(mode="json"),
        "depth": settings.depth.model_dump(mode="json", exclude_defaults=True),
        "robots": settings.robots,
    }
    return {
        "format": FORMAT,
        "settings": json.dumps(told),
        "bundle": bundle.name,
        "bundle_manifest_sha256": file_sha256(bundle / MANIFEST),
        "versions": json.dumps({"python": platform.python_version(), **installed_versions(_PACKAGES)}),
        "machine": platform.machine(),
    }
