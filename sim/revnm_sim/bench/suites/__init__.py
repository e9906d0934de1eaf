"""Suites of ``revnm-sim bench``: what the robot's controller and its safety can do, with plans from the expert."""

from __future__ import annotations

import argparse

from revnm_client.errors import ConfigError
from revnm_sim.bench.suites.controller import CONTROLLER, course_keys
from revnm_sim.bench.suites.fault_suite import FAULT_SUITE, fault_keys
from revnm_sim.engine import Engine

__all__ = ["SUITES", "run_suite"]

SUITES = (CONTROLLER.name, FAULT_SUITE.name)


def run_suite(args: argparse.Namespace, engine: Engine) -> str:
    """Run what is missing of a suite in a folder, write the report and return its table.

    Raises:
        ConfigError: There is nothing to run.
        FileError: The folder cannot be made, or holds a journal of something else.
    """
    if min(args.scenes, args.runs) < 1 or args.seed < 0:
        raise ConfigError("expected --scenes and --runs of at least 1, and --seed of at least 0")
    options = ["--suite", args.suite, "--seed", str(args.seed), "--out", str(args.out)]
    if args.suite == CONTROLLER.name:
        keys = course_keys(scenes=args.scenes, seed=args.seed)
        return CONTROLLER.measure(keys, engine, args.out, [*options, "--scenes", str(args.scenes)])
    runs = fault_keys(runs=args.runs, seed=args.seed)
    return FAULT_SUITE.measure(runs, engine, args.out, [*options, "--runs", str(args.runs)])
