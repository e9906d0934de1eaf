"""The benchmark: the live pipeline and controller in simulated time, many trials, one table."""
