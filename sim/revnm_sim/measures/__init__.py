"""What ``revnm-sim`` measures beside the benchmark, a command each."""
