"""A base and a LiDAR, each at a serial port: the example of docs/drivers.md.

The base says ``O x y yaw v w`` (m, rad, m/s, rad/s) and obeys ``V v w``; without one for 0.25 s it stops by itself.
The LiDAR says ``S`` and 360 ranges in mm, one a degree, counter-clockwise from its forward; 0 where it sees nothing.
"""

import math
import threading
import time

import numpy as np
import serial

from revnm_client import validate
from revnm_client.errors import LinkError, MessageError
from revnm_client.geometry import Pose2
from revnm_client.messages import Odometry, Scan, Velocity

SCAN_TOOK_NS = 140_000_000  # a turn, and 1.8 kB through the line: a stamp is of the first beam, and rather early
WRITE_S = 0.02  # of the loop's 0.05; a write that was only late, as on a busy core, is no failure
LIMITS = {"x": 1e6, "y": 1e6, "yaw": 1e6, "v": 10.0, "w": 10.0}


class SerialRobot:
    """In the settings: ``driver: serial_robot:SerialRobot``, with ``base`` and ``lidar`` as its options."""

    shared = False  # the server cannot hear a serial port

    def __init__(self, context, *, base, lidar, baud=460800):
        self.rejected, self.last_error, self._gone, self._newest = 0, "", None, {}
        self._closing = threading.Event()
        try:
            self._ports = [serial.Serial(port, baud, timeout=0.2, write_timeout=WRITE_S) for port in (base, lidar)]
        except serial.SerialException as error:
            raise LinkError(f"cannot open the robot: {error}") from error
        readers = zip(self._ports, (self._odometry, self._scan), strict=True)
        self._threads = [threading.Thread(target=self._read, args=reader) for reader in readers]
        for thread in self._threads:
            thread.start()

    def take_scan(self):
        return self._newest.pop(Scan, None)

    def take_odometry(self):
        return self._newest.pop(Odometry, None)

    def drive(self, velocity):
        try:
            self._ports[0].write(f"V {velocity.v_mps:.3f} {velocity.w_radps:.3f}\n".encode())
        except serial.SerialException as error:
            raise LinkError(f"cannot send a velocity: {error}") from error

    def trouble(self):
        return self._gone

    def close(self):
        try:
            self.drive(Velocity(0.0, 0.0))
        finally:
            self._closing.set()
            for thread, port in zip(self._threads, self._ports, strict=True):
                thread.join()
                port.close()

    def _read(self, port, parse):
        line = b""
        while not self._closing.is_set() and self._gone is None:
            try:
                if port.in_waiting > 8192:  # it has waited, and would be stamped as new
                    port.reset_input_buffer()
                    line = b""
                line += port.readline(4096)  # what came in 0.2 s, where that is no whole line
                if line.endswith(b"\n") or len(line) > 4096:
                    message = parse(*line.split())
                    self._newest[type(message)] = message
                    line = b""
            except OSError as error:  # serial.SerialException is one
                self._gone = f"{port.port} is gone: {error}"
            except (ValueError, TypeError, MessageError) as error:
                self.rejected, self.last_error, line = self.rejected + 1, f"{port.port}: {error}", b""

    def _odometry(self, kind, *words):
        if kind != b"O" or len(words) != len(LIMITS):
            raise MessageError(f"{kind[:9]!r} and {len(words)} numbers: expected O and {len(LIMITS)}")
        x, y, yaw, v, w = (
            validate.number(float(word), what=what, low=-limit, high=limit)
            for word, (what, limit) in zip(words, LIMITS.items(), strict=True)
        )
        return Odometry(time.time_ns(), Pose2(x, y, yaw), Velocity(v, w))

    def _scan(self, kind, *words):
        if kind != b"S":
            raise MessageError(f"{kind[:9]!r}: expected S")
        ranges_m = validate.ranges(np.array(words, dtype=float) / 1000.0, low=360, high=360)
        return Scan(time.time_ns() - SCAN_TOOK_NS, 0.0, math.radians(1.0), 0.1, 12.0, ranges_m)
