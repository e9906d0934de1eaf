"""The simulator in real time: a robot, an IP camera, and the demo of processes around them."""
