"""The graphics card's ray caster draws what the CPU's draws."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import cuda

from revnm_client.errors import ConfigError
from revnm_sim.rays.cuda_raycast import cast_depths_cuda
from revnm_sim.world import primitive_arrays

from .cuda_agreement import FAMILIES, SPEC, differing_share

_GRAZES = 0.002  # rays along edges may fall to either side


@pytest.mark.skipif(not cuda.is_available(), reason="no CUDA device: numba finds none")
@pytest.mark.parametrize("family", FAMILIES)
def test_a_device_agrees_with_the_cpu(family: str) -> None:
    for seed in range(5):
        assert differing_share(family, seed, 8, (96, 128)) < _GRAZES


def test_the_kernel_agrees_with_the_cpu_in_numbas_simulator() -> None:
    script = Path(__file__).with_name("cuda_agreement.py")
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}
    done = subprocess.run(
        [sys.executable, str(script)], check=True, timeout=120, env=environment, capture_output=True, text=True
    )
    assert float(done.stdout) <= 0.01


@pytest.mark.skipif(cuda.is_available(), reason="there is a CUDA device")
def test_without_a_device_it_says_so() -> None:
    with pytest.raises(ConfigError, match="no CUDA device"):
        cast_depths_cuda(primitive_arrays(()), [], (SPEC.ego_px, SPEC.ego_px))
