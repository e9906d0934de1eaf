"""A camera that learns its own focal length, tilt and height from robots that drive in front of it."""
