"""``revnm-sim soak``: half an hour of random goals and random faults, and whether the system bears them."""

from __future__ import annotations

import argparse
import os
import shlex
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ConfigError, LinkError
from revnm_sim.bench.report import make_folder, table, write_report
from revnm_sim.live.children import ChildError
from revnm_sim.scenario import demo_scenario
from revnm_sim.soak.faults import Fault, FaultTiming, faults_of, inflict, shuffled
from revnm_sim.soak.figures import (
    Latencies,
    broken_bars,
    counts,
    fault_rows,
    missed_goal_row,
    process_row,
    verdict_of,
)
from revnm_sim.soak.goals import GoalDraw
from revnm_sim.soak.operator import Drive, Operator
from revnm_sim.soak.system import System, running

_LEAST_EVERY_S = 8.0
_EVERY = (0.75, 1.25)
_LEAST_APART_S = 4.0  # from a recovery to the next fault
_WAIT_FOR_MOTION_S = 10.0
_DRIVES_MPS = 0.1
_KILLING_SHARE = 0.25  # of the time; processes live on for the rest, in which their memory is compared
_POLL_S = 0.2
_FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--minutes", type=float, default=30.0, help="how long (default: 30)")
    parser.add_argument("--every", type=float, default=20.0, help="seconds from fault to fault (default: 20)")
    parser.add_argument("--seed", type=int, default=0, help="of the world, the goals and the faults (default: 0)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json and logs")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report, print the tables; return 1 where a bar does not hold."""
    if not args.minutes > 0.0 or args.every < _LEAST_EVERY_S or args.seed < 0:
        limits = f"--minutes over 0, --every of {_LEAST_EVERY_S:g} s at least, and --seed of at least 0"
        raise ConfigError(f"expected {limits}")
    make_folder(args.out)
    scenario = demo_scenario(args.seed)
    goal_rng, fault_rng = np.random.default_rng(args.seed).spawn(2)
    goals = GoalDraw(scenario, goal_rng)
    rows: list[dict[str, Any]] = []
    broken: list[str] = []
    try:
        with running(scenario, args.seed, args.out) as system:
            operator = Operator(system.api, lambda: system.place_m, goals)
            soak = _Soak(system, operator, fault_rng, minutes=args.minutes, every_s=args.every)
            rows.extend(soak.rows())  # those before an error count
    except (ChildError, LinkError) as error:
        if not rows:
            raise
        broken.append(f"ended early: {error}")
    return _report(args, soak, rows, broken)


def _report(args: argparse.Namespace, soak: _Soak, rows: list[dict[str, Any]], broken: list[str]) -> int:
    faults, missed = fault_rows(soak.timings), [missed_goal_row(d) for d in soak.drives if not d.reached]
    verdict = verdict_of(rows, faults, ready_s=soak.ready_s, undisturbed=soak.undisturbed_rows)
    options = ["--minutes", f"{args.minutes:g}", "--every", f"{args.every:g}", "--seed", str(args.seed)]
    command = shlex.join(["revnm-sim", "soak", *options])
    write_report(args.out / "report.json", [*rows, verdict], command, more={"faults": faults, "missed_goals": missed})
    broken = [*broken, *broken_bars(verdict)]
    print(*(table(each) for each in (rows, faults, missed, [verdict]) if each), sep="\n\n")
    print("", *(broken or ["all bars hold"]), sep="\n")
    return _FAILED if broken else 0


class _Soak:
    """Drives and breaks a running system.

    Attributes:
        timings: Of all faults.
        undisturbed_rows: How many rows, the last ones, begin when no process is killed any more.
    """

    def __init__(
        self, system: System, operator: Operator, rng: np.random.Generator, *, minutes: float, every_s: float
    ) -> None:
        self.timings: list[FaultTiming] = []
        self.undisturbed_rows = 0
        self._system, self._operator, self._rng = system, operator, rng
        self._every_s = every_s
        self._began_s, self._length_s = time.monotonic(), 60.0 * minutes
        faults = faults_of(system, resume=operator.resume)
        self._early = shuffled([*faults, *(fault for fault in faults if fault.kills)], rng)
        self._late = shuffled([fault for fault in faults if not fault.kills], rng)
        self._due_s = self._began_s + every_s
        self._latencies = Latencies()
        self._before = {"contacts": 0, **counts([], [])}

    @property
    def ready_s(self) -> float:
        """After how long the server was ready at first."""
        return self._system.ready_s

    @property
    def drives(self) -> list[Drive]:
        """Those that have ended."""
        return self._operator.drives

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield a row after each minute, or each tenth of less than ten."""
        count = max(10, round(self._length_s / 60.0))
        for number in tqdm(range(1, count + 1), desc="soak", unit=" rows"):
            begin_s, ends_s = (self._began_s + self._length_s * n / count for n in (number - 1, number))
            self.undisturbed_rows += not self._kills(begin_s)
            while time.monotonic() < ends_s:
                self._step()
                threading.Event().wait(_POLL_S)
            yield self._row()

    def _step(self) -> None:
        """Look after the goal, and let something fail when it is due: while the robot drives, if it does soon."""
        state = self._system.state()
        if state is None:
            return
        self._latencies.add(state)
        robot = state["robots"][0]
        self._operator.look(robot)
        overdue_s = time.monotonic() - self._due_s
        if overdue_s > _WAIT_FOR_MOTION_S or (overdue_s > 0.0 and _drives(robot)):
            self._fail()

    def _fail(self) -> None:
        began_s = time.monotonic()
        fault = self._next_fault(began_s)
        self.timings.append(inflict(fault, self._system, hold_s=self._rng.uniform(*fault.hold_s)))
        ended_s = time.monotonic()
        self._operator.grant(ended_s - began_s)
        self._due_s = max(began_s + self._every_s * self._rng.uniform(*_EVERY), ended_s + _LEAST_APART_S)

    def _next_fault(self, now_s: float) -> Fault:
        return next(self._early if self._kills(now_s) else self._late)

    def _kills(self, now_s: float) -> bool:
        """Tell whether processes are still killed at a time."""
        return now_s - self._began_s < _KILLING_SHARE * self._length_s

    def _row(self) -> dict[str, Any]:
        before, pid = self._before, self._system.children.pid
        self._before = now = {"contacts": self._system.simulation.contacts, **counts(self.drives, self.timings)}
        return {
            "minute": round((time.monotonic() - self._began_s) / 60.0, 1),
            "load": round(os.getloadavg()[0], 1),
            **{key: now[key] - before[key] for key in now},
            **process_row("server", pid("server")),
            **process_row("robot", pid("robot")),
            **self._latencies.take(),
        }


def _drives(robot: dict[str, Any]) -> bool:
    return robot["robot_state"] is not None and robot["robot_state"]["v_mps"] >= _DRIVES_MPS
