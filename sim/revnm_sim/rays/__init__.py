"""Exact depth images and laser scans of a world, by compiled loops and on a graphics card."""
