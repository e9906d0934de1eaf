"""Worlds made by seed, family by family, and where a camera stands in them."""
