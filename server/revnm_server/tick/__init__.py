"""The server's tick: from the newest picture to waypoints for each robot, and what it leaves behind."""
