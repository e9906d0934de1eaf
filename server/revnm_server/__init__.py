"""ReVNM beside the camera: camera, perception, policy, operator page.

Kept empty of imports on purpose: training imports :mod:`revnm_server.observation` on machines that have neither
Zenoh nor FastAPI.
"""
