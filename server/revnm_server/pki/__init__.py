"""A small authority of one's own, and the certificates that it gives to the server and to each robot."""

from revnm_server.pki.expiry import CertificateWatch, Ending, endings
from revnm_server.pki.folder import (
    Issued,
    create_authority,
    issue_robot,
    issue_server,
    issued,
    read_certificate,
)

__all__ = [
    "CertificateWatch",
    "Ending",
    "Issued",
    "create_authority",
    "endings",
    "issue_robot",
    "issue_server",
    "issued",
    "read_certificate",
]
