"""The networks of the paper, with sizes from a preset. Torch only: no data, no files."""
