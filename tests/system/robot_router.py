"""The router on the robot, as zenoh-bridge-ros2dds is one: ``python robot_router.py LISTEN CONNECT...``.

A process of its own, so that it can be killed. As the bridge does, it keeps Zenoh's own settings for leases and for
trying again; only scouting is off, because other tests may run on this machine.
"""

from __future__ import annotations

import json
import signal
import sys

import zenoh


def main(listen: str, *connect: str) -> None:
    """Route until SIGTERM."""
    settings = {
        "mode": "router",
        "listen/endpoints": [listen],
        "connect/endpoints": connect,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        print("routes", flush=True)
        signal.sigwait([signal.SIGTERM])


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    main(*sys.argv[1:])
