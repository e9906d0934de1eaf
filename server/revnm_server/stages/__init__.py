"""The learnt stages of a tick, behind the ports that the pipeline knows: depth, exo2ego, policy."""
