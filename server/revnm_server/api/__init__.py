"""HTTP: the operator's page, the API behind it, and health for whoever runs the server."""

from revnm_server.api.application import create_application

__all__ = ["create_application"]
