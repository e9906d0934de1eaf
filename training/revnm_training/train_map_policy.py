"""Trains the policy over the lifted map on the expert's waypoints, on what truly stands there, and on costs."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from revnm_server.mapping.map_window import LAYERS
from revnm_training.batches import add_noise, gather, mirror, signed, unit
from revnm_training.map_cache import UNREACHED
from revnm_training.networks.map_policy import Dense, MapPolicyOutput, map_policy_loss
from revnm_training.preset import MapPolicyConfig
from revnm_training.sample_set import Rows, SampleSet
from revnm_training.trainer import Batch
from revnm_training.waypoint_errors import waypoint_errors

_COLUMNS = ("map", "occupied", "cost", "way", "aim", "ego", "waypoints")
_IMAGINED_SHARE = 0.75
_VALIDATION_SAMPLES = 2048
_VALIDATION_BATCH = 128
_NEAR_CELLS = slice(8, 88)  # within 4 m
_COST_MIDDLE = 127.0
_LEAST = 1e-3  # probability


class MapPolicyTask:
    """Map, way, goal and ego depth → waypoints, what stands where, and costs."""

    kind = "policy"

    def __init__(self, samples: SampleSet, imagined: Rows | None, config: MapPolicyConfig, *, kl_weight: float) -> None:
        """Take the data.

        Args:
            samples: Rendered by :func:`revnm_training.map_cache.render_map_samples`.
            imagined: (M, e, e) imagined ego depth as bytes; None trains on the true one only.
            config: Weights of the losses.
            kl_weight: β.
        """
        self._samples, self._imagined, self._config, self._kl_weight = samples, imagined, config, kl_weight
        self.train_size = len(samples.train)
        self.data = samples.describe() | {"imagined_ego_share": 0.0 if imagined is None else _IMAGINED_SHARE}

    def batch(self, index: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Gather observations and labels; three quarters see imagined ego depth, where there is any."""
        return self._gather(self._samples.train[index], rng.random(len(index)) < _IMAGINED_SHARE)

    def loss(self, network: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the loss of a batch, half of it mirrored."""
        batch = mirror(batch, generator)
        window = add_noise(unit(batch["map"]), generator)
        output = network(window, batch["way"], batch["aim"], signed(batch["ego"]), batch["waypoints"])
        return map_policy_loss(output, batch["waypoints"], _dense(batch), self._config, kl_weight=self._kl_weight)

    def validate(self, network: nn.Module, device: torch.device) -> dict[str, float]:
        """Return errors of the waypoints, beside those of the way that came in, and of the dense heads.

        ``hidden_nats`` is the cross entropy of what stands in cells within 4 m that the map does not know, and
        ``hidden_base_nats`` that of their mean; ``seen_nats`` that in those that it knows, and ``seen_map_nats`` the
        map's own.
        """
        chosen = self._samples.validation
        chosen = chosen[:: max(1, len(chosen) // _VALIDATION_SAMPLES)]
        predicted, true, ways = [], [], []
        dense = _DenseErrors()
        for start in range(0, len(chosen), _VALIDATION_BATCH):
            index = chosen[start : start + _VALIDATION_BATCH]
            batch = {name: x.to(device) for name, x in self._gather(index, np.full(len(index), True)).items()}
            window = unit(batch["map"])
            output = network(window, batch["way"], batch["aim"], signed(batch["ego"]), None)
            predicted.append(output.waypoints.float().cpu().numpy())
            true.append(batch["waypoints"].cpu().numpy())
            ways.append(batch["way"][:, : true[-1].shape[1]].cpu().numpy())
            dense.add(window, output, _dense(batch))
        errors = waypoint_errors(np.concatenate(predicted), np.concatenate(true))
        by_way = waypoint_errors(np.concatenate(ways), np.concatenate(true))
        return errors | {f"way_{name}": by_way[name] for name in ("l1_m", "first_deg", "last_deg")} | dense.measured()

    def _gather(self, index: NDArray[np.int64], is_imagined: NDArray[np.bool_]) -> Batch:
        index = np.sort(index)
        batch = gather(self._samples.columns, _COLUMNS, index)
        side = batch["map"].shape[-1]
        bits = np.unpackbits(batch["occupied"].numpy(), axis=1)
        batch["occupied"] = torch.from_numpy(bits).unflatten(1, (side, side))
        if self._imagined is not None:
            chosen = torch.from_numpy(is_imagined).view(-1, 1, 1, 1)
            batch["ego"] = torch.where(chosen, torch.from_numpy(self._imagined[index])[:, None], batch["ego"])
        return batch


def _dense(batch: Batch) -> Dense:
    cost = batch["cost"]
    return Dense(batch["occupied"].float(), cost.float() / _COST_MIDDLE - 1.0, (cost != UNREACHED).float())


class _DenseErrors:
    """Sums up the dense heads' errors."""

    def __init__(self) -> None:
        self._sums = dict.fromkeys(("hidden", "hidden_nats", "standing", "seen", "seen_nats", "map_nats"), 0.0)
        self._cost = self._batches = 0.0

    def add(self, window: Tensor, output: MapPolicyOutput, dense: Dense) -> None:
        near = (slice(None), _NEAR_CELLS, _NEAR_CELLS)
        hidden = window[:, LAYERS.index("unseen")][near] > 0.5
        logits, truth = output.occupied.float()[near], dense.occupied[near]
        measured = window[:, LAYERS.index("obstacle")][near].clamp(_LEAST, 1.0 - _LEAST).logit()
        self._count("hidden", hidden)
        self._count("seen", ~hidden)
        self._count("standing", truth[hidden])
        self._count("hidden_nats", _nats(logits, truth)[hidden])
        self._count("seen_nats", _nats(logits, truth)[~hidden])
        self._count("map_nats", _nats(measured, truth)[~hidden])
        self._cost += float(((output.cost.float() - dense.cost).abs() * dense.reached).sum() / dense.reached.sum())
        self._batches += 1.0

    def measured(self) -> dict[str, float]:
        sums = self._sums
        hidden, seen = max(sums["hidden"], 1.0), max(sums["seen"], 1.0)
        share = min(max(sums["standing"] / hidden, _LEAST), 1.0 - _LEAST)
        return {
            "hidden_nats": sums["hidden_nats"] / hidden,
            "hidden_base_nats": float(-share * np.log(share) - (1.0 - share) * np.log(1.0 - share)),
            "seen_nats": sums["seen_nats"] / seen,
            "seen_map_nats": sums["map_nats"] / seen,
            "cost_error": self._cost / self._batches,
        }

    def _count(self, name: str, values: Tensor) -> None:
        self._sums[name] += float(values.sum())


def _nats(logits: Tensor, truth: Tensor) -> Tensor:
    return functional.binary_cross_entropy_with_logits(logits, truth, reduction="none")
