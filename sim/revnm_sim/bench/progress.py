"""Trials run in parallel, with a bar on the terminal, each kept as soon as it has ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tqdm import tqdm

from revnm_sim.bench.journal import Journal, KeyT, ResultT
from revnm_sim.engine import Engine


def run_missing(
    run: Callable[[KeyT], ResultT],
    keys: Sequence[KeyT],
    engine: Engine,
    journal: Journal[KeyT, ResultT],
    count: Callable[[KeyT, ResultT], str],
) -> None:
    """Run the trials that a journal lacks; each is in it as soon as it has ended.

    Args:
        run: Runs one trial.
        keys: The trials that are wanted.
        engine: Where they run.
        journal: Those that are there, and where the others go.
        count: Takes in each trial that ends, and returns what the bar says of all so far.
    """
    missing = [key for key in keys if key not in journal.results]
    with tqdm(total=len(keys), initial=len(keys) - len(missing), unit="trial", smoothing=0.05) as bar:
        for key, result in engine.map(run, missing):
            journal.add(key, result)
            bar.set_postfix_str(count(key, result), refresh=False)
            bar.update()
