"""The commands of ``revnm-train`` that train a network: their options, and how they start."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from revnm_client.exit_status import INTERRUPTED
from revnm_training.preset import load_preset

if TYPE_CHECKING:
    from revnm_training.precision import Precision
    from revnm_training.run_settings import RunSettings


def add_preset(parser: argparse.ArgumentParser) -> None:
    """Declare ``--preset``."""
    parser.add_argument("--preset", default="edge", help="edge, paper or a YAML file (default: edge)")


def _add_training(parser: argparse.ArgumentParser) -> None:
    add_preset(parser)
    parser.add_argument("--cache", type=Path, required=True, help="folder for rendered data, made once and kept")
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoint and logs")
    parser.add_argument("--steps", type=int, required=True, help="length of the run and of its schedule")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes that render (default: 2)")
    parser.add_argument(
        "--precision",
        choices=("auto", "bf16-mixed", "32-true"),
        default="auto",
        help="auto: bfloat16 where the machine is fast in it (default)",
    )


def _add_run(parser: argparse.ArgumentParser) -> None:
    _add_training(parser)
    parser.add_argument("--devices", type=int, default=1, help="graphics cards, or else processes, of each machine")
    parser.add_argument("--nodes", type=int, default=1, help="machines; start the command on each with torchrun")
    parser.add_argument(
        "--accumulate", type=int, default=1, metavar="N", help="compute each batch in N parts, to save memory"
    )
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")


def _add_render(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--render", choices=("cpu", "cuda"), default="cpu", help="what casts ego depth (default: cpu)")


def add_depth(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``depth``."""
    _add_run(parser)
    parser.add_argument("--pictures", type=int, default=12000, help="pictures to render (default: 12000)")
    parser.set_defaults(command=_depth)


def add_exo2ego(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``exo2ego``."""
    _add_run(parser)
    _add_render(parser)
    parser.add_argument("--data", type=Path, required=True, help="folder of episodes")
    parser.set_defaults(command=_exo2ego)


def add_policy(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``policy``."""
    _add_run(parser)
    _add_render(parser)
    parser.add_argument("--data", type=Path, required=True, help="folder of episodes")
    parser.add_argument("--exo2ego", type=Path, help="checkpoint of the denoiser; without it ego depth is exact")
    parser.set_defaults(command=_policy)


def add_dagger(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``dagger``."""
    _add_training(parser)
    parser.add_argument("--data", type=Path, required=True, help="folder of the episodes that the policy learnt from")
    parser.add_argument("--policy", type=Path, required=True, help="checkpoint to begin with")
    parser.add_argument("--exo2ego", type=Path, required=True, help="checkpoint")
    depth = parser.add_mutually_exclusive_group()
    depth.add_argument("--depth", type=Path, help="checkpoint")
    depth.add_argument("--base", type=Path, help="bundle whose depth network is taken")
    parser.add_argument("--rounds", type=int, default=3, help="how often to retrain (default: 3)")
    parser.add_argument("--rollouts", type=int, default=200, help="drives of a round (default: 200)")
    parser.add_argument("--states", type=int, default=20, help="labelled states of a drive (default: 20)")
    parser.add_argument("--perception", choices=("truth", "models"), default="truth", help="depth while driving")
    parser.set_defaults(command=_dagger)


def _depth(options: argparse.Namespace) -> int:
    from revnm_training.train_depth import train_depth

    done = train_depth(
        load_preset(options.preset),
        _settings(options),
        cache=options.cache,
        pictures=options.pictures,
        jobs=options.jobs,
    )
    return _report(options, done)


def _exo2ego(options: argparse.Namespace) -> int:
    from revnm_training.train_exo2ego import train_exo2ego

    preset = load_preset(options.preset)
    done = train_exo2ego(
        preset,
        _settings(options),
        data=options.data,
        cache=options.cache,
        jobs=options.jobs,
        render=options.render,
    )
    return _report(options, done)


def _policy(options: argparse.Namespace) -> int:
    from revnm_training.sample_set import DataSource
    from revnm_training.train_policy import train_policy

    done = train_policy(
        load_preset(options.preset),
        _settings(options),
        sources=[DataSource(options.data, options.cache)],
        exo2ego=options.exo2ego,
        jobs=options.jobs,
        render=options.render,
    )
    return _report(options, done)


def _dagger(options: argparse.Namespace) -> int:
    from revnm_training.dagger import DaggerConfig, dagger
    from revnm_training.sample_set import DataSource

    config = DaggerConfig(
        out=options.out,
        source=DataSource(options.data, options.cache),
        policy=options.policy,
        exo2ego=options.exo2ego,
        depth=options.depth,
        base=options.base,
        perception=options.perception,
        rounds=options.rounds,
        rollouts=options.rollouts,
        states=options.states,
        steps=options.steps,
        seed=options.seed,
        jobs=options.jobs,
        precision=_precision(options),
    )
    return _report(options, dagger(load_preset(options.preset), config))


def _settings(options: argparse.Namespace) -> RunSettings:
    from revnm_training.run_settings import RunSettings

    return RunSettings(
        out=options.out,
        preset=load_preset(options.preset).name,
        steps=options.steps,
        seed=options.seed,
        precision=_precision(options),
        resume=options.resume,
        devices=options.devices,
        nodes=options.nodes,
        accumulate=options.accumulate,
    )


def _precision(options: argparse.Namespace) -> Precision:
    from revnm_training.precision import fast_precision

    return fast_precision() if options.precision == "auto" else options.precision


def _report(options: argparse.Namespace, done: bool) -> int:
    from lightning_fabric.utilities import rank_zero_only

    say = rank_zero_only(print)
    if done:
        say(f"done: {options.out}")
        return 0
    say(f"stopped and saved: go on with --resume --out {options.out}", file=sys.stderr)
    return INTERRUPTED
