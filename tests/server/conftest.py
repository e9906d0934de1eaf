from __future__ import annotations

from pathlib import Path

import pytest

from .tiny_bundle import write_tiny_bundle


@pytest.fixture
def tiny_bundle(tmp_path: Path) -> Path:
    """A complete bundle that steers along the straight line in the picture."""
    return write_tiny_bundle(tmp_path / "tiny_bundle")
