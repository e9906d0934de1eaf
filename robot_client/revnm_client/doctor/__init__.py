"""The doctor: reaches server and robot, looks for some seconds, and judges what was seen. It never moves a robot."""

from revnm_client.doctor.judgement import Finding, Verdict, examine
from revnm_client.doctor.observation import Observation, Received, Series, Server, observe
from revnm_client.doctor.reach import unreachable

__all__ = ["Finding", "Observation", "Received", "Series", "Server", "Verdict", "examine", "observe", "unreachable"]
