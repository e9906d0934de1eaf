"""How good imagined ego depth is, against ray-cast truth."""
