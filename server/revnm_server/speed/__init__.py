"""Measures what a tick costs: a room that moves, the real pipelines before it, and other runtimes to compare with."""
