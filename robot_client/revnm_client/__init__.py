"""ReVNM on the robot: the wire contract, the LiDAR MPPI controller and the safety supervisor.

Must stay light: numpy, eclipse-zenoh, rosbags and nothing else. The server imports the contract from here.
"""
