"""What zenoh-bridge-ros2dds is on a ROS 2 robot: a Zenoh router there, which is connected to the server's."""

from __future__ import annotations

import json

import zenoh

from revnm_client.link import LEASE_MS


def open_bridge(listen: str, server: str) -> zenoh.Session:
    """Open the router; it looks for the server by itself, for as long as it takes.

    Args:
        listen: Endpoint for what is on the robot, such as ``tcp/127.0.0.1:7448``.
        server: Endpoint of the server's router.
    """
    settings = {
        "mode": "router",
        "listen/endpoints": [listen],
        "connect/endpoints": [server],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
