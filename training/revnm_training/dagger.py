"""DAgger: drive with the policy, let the expert label what it met, add that to the data, and train on.

Source: Ross, Gordon and Bagnell, 2011, arXiv:1011.0686; the paper, section IV-C.

A round's folder holds the ``bundle`` that drove, its ``drives``, and, from the second on, the ``policy`` run that led
there. A run that was stopped goes on where it was.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from revnm_server.networks.manifest import MANIFEST
from revnm_sim.bench.methods import Perception
from revnm_training.episodes import layout_of
from revnm_training.export import export_bundle
from revnm_training.precision import Precision
from revnm_training.preset import Preset
from revnm_training.rollouts import Outcome, RolloutConfig, roll_out
from revnm_training.run_settings import CHECKPOINT, RunSettings
from revnm_training.sample_set import DataSource
from revnm_training.train_policy import train_policy
from revnm_training.training_plots import RoundResult, plot_success

_RATE = 0.5  # of the preset's learning rate: the weights are good already
_REPEAT = 4  # times that a labelled drive counts: there are far fewer than made-up states


@dataclass(frozen=True, slots=True)
class DaggerConfig:
    """What to do.

    Attributes:
        out: Folder of the rounds.
        source: The data that the first policy was trained on.
        policy: Its checkpoint.
        exo2ego: Checkpoint of the denoiser.
        depth: Checkpoint of the depth network; None takes that of ``base``.
        base: Bundle that the depth network comes from where it has no checkpoint.
        perception: Where the drives' depth comes from.
        rounds: How often to retrain.
        rollouts: Drives a round.
        states: Labelled states of a drive.
        steps: Training steps a round.
        seed: Of round 0; each has the next one.
        jobs: Processes.
        precision: Of the training.
    """

    out: Path
    source: DataSource
    policy: Path
    exo2ego: Path
    depth: Path | None
    base: Path | None
    perception: Perception
    rounds: int
    rollouts: int
    states: int
    steps: int
    seed: int
    jobs: int
    precision: Precision


def dagger(preset: Preset, config: DaggerConfig) -> bool:
    """Run the rounds; ``rounds.csv`` and ``success.png`` tell of each policy, the last one included.

    Returns:
        Whether the end was reached.

    Raises:
        ConfigError: A folder holds something else.
        FileError: A checkpoint, bundle or file of a round does not fit.
    """
    policy, sources, log = config.policy, [config.source], RoundLog(config.out)
    for number in range(config.rounds + 1):
        drives = _drive(preset, config, number, policy)
        log.add(number, number * config.steps, drives)
        if number < config.rounds:
            folder = _folder(config, number)
            sources.append(DataSource(folder / "drives", folder / "samples", _REPEAT))
            policy, begin = _folder(config, number + 1) / "policy" / CHECKPOINT, policy
            if not _retrain(preset, config, policy.parent, sources, begin):
                return False
    return True


class RoundLog:
    """Tells how well each round's policy drives."""

    def __init__(self, out: Path) -> None:
        self._out, self._results, self._rows = out, list[RoundResult](), list[Mapping[str, object]]()

    def add(self, number: int, step: int, drives: Sequence[Outcome]) -> None:
        """Add a round and write all anew."""
        success = float(np.mean([each.success for each in drives]))
        collisions = sum(each.collision for each in drives)
        result = RoundResult(
            step=step,
            label=f"round {number}",
            success_rate=round(success, 4),
            spl=round(float(np.mean([each.spl for each in drives])), 4),
            trials=len(drives),
        )
        more = {"collisions": collisions, "labelled_states": sum(each.states for each in drives)}
        self._results.append(result)
        self._rows.append(asdict(result) | more)
        with (self._out / "rounds.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(self._rows[0]))
            writer.writeheader()
            writer.writerows(self._rows)
        plot_success(self._out, self._results)
        tqdm.write(f"round {number}: " + "  ".join(f"{name} {value}" for name, value in self._rows[-1].items()))


def _folder(config: DaggerConfig, number: int) -> Path:
    return config.out / f"round_{number}"


def _drive(preset: Preset, config: DaggerConfig, number: int, policy: Path) -> list[Outcome]:
    folder = _folder(config, number)
    bundle = folder / "bundle"
    if not (bundle / MANIFEST).exists():
        checkpoints = {"policy": policy, "exo2ego": config.exo2ego}
        if config.depth is not None:
            checkpoints["depth"] = config.depth
        export_bundle(preset, checkpoints, bundle, base=config.base)
    rollouts = RolloutConfig(
        out=folder / "drives",
        bundle=bundle,
        perception=config.perception,
        rollouts=config.rollouts,
        states=config.states,
        seed=config.seed + number,
        layout=layout_of(preset.observation),
    )
    return roll_out(rollouts, jobs=config.jobs)


def _retrain(preset: Preset, config: DaggerConfig, out: Path, sources: Sequence[DataSource], begin: Path) -> bool:
    rate = _RATE * preset.train_policy.learning_rate
    gentle = replace(preset, train_policy=replace(preset.train_policy, learning_rate=rate))
    settings = RunSettings(
        out=out, preset=preset.name, steps=config.steps, seed=config.seed, precision=config.precision, resume=True
    )
    return train_policy(gentle, settings, sources=sources, exo2ego=config.exo2ego, jobs=config.jobs, begin=begin)
