"""What carries the robot: the port that the control loop drives, and one module for each kind of robot.

A driver gives scans and odometry and takes velocities; whether it speaks ROS 2, gRPC or to a serial port is its
own affair. One from elsewhere is named in the settings as ``package.module:Class``.
"""

from revnm_client.drivers.opening import DriverContext, open_driver
from revnm_client.drivers.port import RobotDriver

__all__ = ["DriverContext", "RobotDriver", "open_driver"]
