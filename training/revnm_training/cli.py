"""``revnm-train``: data, training and export, from the command line.

torch is imported by the commands that need it, so that making data starts fast in every process.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from revnm_client.exit_status import INTERRUPTED, exit_status
from revnm_client.version_option import VersionAction
from revnm_sim.engine import ENGINES, Engine
from revnm_training.cli_runs import add_dagger, add_depth, add_exo2ego, add_policy, add_preset
from revnm_training.preset import load_preset


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its :func:`revnm_client.exit_status.exit_status`."""
    options = build_parser().parse_args(arguments)
    return exit_status(
        "revnm-train", lambda: int(options.command(options)), stopped="stopped; the same command goes on"
    )


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of every command."""
    parser = argparse.ArgumentParser(prog="revnm-train", description=__doc__)
    parser.add_argument("--version", action=VersionAction, const="revnm-training")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_synth(commands.add_parser("synth", help="make a data set of labelled episodes"))
    add_depth(commands.add_parser("depth", help="train the depth network"))
    add_exo2ego(commands.add_parser("exo2ego", help="train the denoiser that imagines ego depth"))
    add_policy(commands.add_parser("policy", help="train the navigation policy"))
    add_dagger(commands.add_parser("dagger", help="drive with the policy, label what it met, and train on"))
    _add_export(commands.add_parser("export", help="write a model bundle and check it against PyTorch"))
    _add_quality(commands.add_parser("quality", help="measure a bundle's imagined ego depth, and its depth network"))
    _add_quality_encoder(commands.add_parser("quality-encoder", help="train the encoder that quality compares by"))
    return parser


def _add_synth(parser: argparse.ArgumentParser) -> None:
    add_preset(parser)
    parser.add_argument("--episodes", type=int, required=True, help="worlds, each seen by one camera")
    parser.add_argument("--goals", type=int, default=2, help="goals of an episode (default: 2)")
    parser.add_argument("--states", type=int, default=10, help="states of a goal (default: 10)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--seed", type=int, default=0, help="0 to 999; other seeds have other worlds")
    parser.add_argument("--jobs", type=int, default=2, help="processes, or calls to a cluster at a time (default: 2)")
    parser.add_argument("--engine", choices=ENGINES, default="local", help="where it is made (default: local)")
    parser.add_argument("--address", default="", help="scheduler of the Ray or Dask cluster; without it one is started")
    parser.set_defaults(command=_synth)


def _add_export(parser: argparse.ArgumentParser) -> None:
    add_preset(parser)
    for kind in ("policy", "exo2ego", "depth"):
        parser.add_argument(f"--{kind}", type=Path, help="checkpoint; without it --base gives the network")
    parser.add_argument("--base", type=Path, help="bundle whose networks are taken over where a checkpoint lacks")
    parser.add_argument(
        "--random-weights",
        action="store_true",
        help="draw the networks that have no checkpoint: a bundle to measure speed with, not to drive",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the bundle")
    parser.add_argument("--weights", type=Path, help="folder for small checkpoints to train on from")
    parser.add_argument("--report", type=Path, action="append", default=[], help="report.json for the manifest")
    parser.set_defaults(command=_export)


def _add_quality(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bundle", type=Path, help="folder of the bundle (default: the one the server comes with)")
    parser.add_argument(
        "--world",
        default="random_pillar,bookstore,warehouse",
        help="comma-separated names or paths of worlds (default: random_pillar,bookstore,warehouse)",
    )
    parser.add_argument("--images", type=int, default=5000, help="images of a world (default: 5000)")
    parser.add_argument("--pictures", type=int, default=300, help="pictures of a world for the depth network")
    parser.add_argument("--steps", type=int, help="diffusion steps (default: the bundle's)")
    parser.add_argument("--seed", type=int, default=1000, help="of worlds, cameras and states (default: 1000)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json; a run there is continued")
    parser.set_defaults(command=_quality)


def _add_quality_encoder(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, help="the ONNX file")
    parser.add_argument("--steps", type=int, required=True, help="length of the run and of its schedule")
    parser.add_argument("--seed", type=int, default=0)
    parser.set_defaults(command=_quality_encoder)


def _synth(options: argparse.Namespace) -> int:
    from revnm_training.episodes import layout_of
    from revnm_training.synth import SynthConfig, synthesise

    config = SynthConfig(
        out=options.out,
        episodes=options.episodes,
        goals=options.goals,
        states=options.states,
        seed=options.seed,
        hidden=True,
        layout=layout_of(load_preset(options.preset).observation),
    )
    labelled, seconds = synthesise(config, Engine(options.engine, options.jobs, options.address))
    print(f"{labelled} labelled samples in {seconds:.1f} s: {labelled / max(seconds, 1e-9):.0f} samples/s")
    return 0


def _export(options: argparse.Namespace) -> int:
    from revnm_training.checkpoint import save_weights
    from revnm_training.export import export_bundle

    named = {"policy": options.policy, "exo2ego": options.exo2ego, "depth": options.depth}
    checkpoints = {kind: path for kind, path in named.items() if path is not None}
    preset = load_preset(options.preset)
    differences = export_bundle(
        preset,
        checkpoints,
        options.out,
        base=options.base,
        random_weights=options.random_weights,
        reports=options.report,
    )
    if options.weights is not None:
        save_weights(checkpoints, options.weights)
    for kind, difference in differences.items():
        print(f"{kind}: ONNX and PyTorch differ by at most {difference:.1e}")
    return 0


def _quality(options: argparse.Namespace) -> int:
    from revnm_server.networks.bundle import default_bundle_path
    from revnm_training.quality.command import QualityConfig, measure_quality

    config = QualityConfig(
        bundle=options.bundle or default_bundle_path(),
        worlds=tuple(dict.fromkeys(options.world.split(","))),
        images=options.images,
        pictures=options.pictures,
        steps=options.steps,
        seed=options.seed,
        jobs=options.jobs,
        out=options.out,
    )
    measure_quality(config)
    return 0


def _quality_encoder(options: argparse.Namespace) -> int:
    from revnm_server.networks.checked_file import file_sha256
    from revnm_training.quality.encoder_training import train_encoder

    difference = train_encoder(options.out, steps=options.steps, seed=options.seed)
    if difference is None:
        print("stopped: nothing was written", file=sys.stderr)
        return INTERRUPTED
    print(f"{options.out}: sha256 {file_sha256(options.out)}, ONNX and PyTorch differ by at most {difference:.1e}")
    return 0
