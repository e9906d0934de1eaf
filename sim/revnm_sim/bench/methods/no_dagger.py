"""ReVNM with models that were trained without recovery data; they come in a bundle of their own."""

from __future__ import annotations

from revnm_sim.bench.methods.revnm import RevnmMethod


class NoDaggerMethod(RevnmMethod):
    """The same pipeline; the bundle makes the difference."""
