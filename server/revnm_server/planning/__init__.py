"""From a map of the floor to a way: what it costs to drive somewhere, and which way is kept."""
