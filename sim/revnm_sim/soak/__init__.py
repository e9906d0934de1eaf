"""``revnm-sim soak``: the demo's world at work for long, with random goals and random faults."""
