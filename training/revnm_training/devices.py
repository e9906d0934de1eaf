"""Where a training run computes: one device, several of one machine, or several machines, through Lightning Fabric.

Every process of a run holds the whole network and takes its slice of each batch; the gradients are averaged. The result
is that of one device with the whole batch, but for batch normalisation, which sees slices.
"""

from __future__ import annotations

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from revnm_training.precision import Precision


def open_fabric(*, devices: int, nodes: int, precision: Precision) -> Fabric:
    """Start the processes of a run that are not there yet, and join them.

    Under ``torchrun`` they are there already. Else this starts the command once more for each further device.

    Args:
        devices: Of each machine: graphics cards where there are any, else processes.
        nodes: Machines.
        precision: Of the arithmetic.
    """
    strategy = "ddp" if devices * nodes > 1 else "auto"
    fabric = Fabric(accelerator="auto", devices=devices, num_nodes=nodes, strategy=strategy, precision=precision)
    fabric.launch()
    return fabric


def average_over_ranks(fabric: Fabric, network: nn.Module) -> None:
    """Replace a network's gradients and floating buffers by their mean over all processes."""
    if fabric.world_size == 1:
        return
    shared = [p.grad for p in network.parameters() if p.grad is not None]
    shared += [buffer for buffer in network.buffers() if buffer.is_floating_point()]
    flat = torch.cat([tensor.flatten().float() for tensor in shared])
    mean = fabric.all_reduce(flat, reduce_op="mean")
    assert isinstance(mean, Tensor)
    for tensor, part in zip(shared, mean.split([tensor.numel() for tensor in shared]), strict=True):
        tensor.copy_(part.view_as(tensor))


def any_rank(fabric: Fabric, flag: bool) -> bool:
    """Return whether the flag is set in any process."""
    if fabric.world_size == 1:
        return flag
    total = fabric.all_reduce(torch.tensor(float(flag), device=fabric.device), reduce_op="sum")
    assert isinstance(total, Tensor)
    return bool(total > 0)
