"""Makes keys and certificates: the authority's, the server's, a robot's. Touches no file.

Keys are on the curve P-256. A robot's certificate has the robot's name as its common name, by which access lists know
it; the server's has the names and addresses by which it is reached, of which clients look for the one they have called.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from revnm_client.errors import ConfigError

_AUTHORITY_NAME, _SERVER_NAME = "ReVNM authority", "ReVNM server"
_AUTHORITY_DAYS, _ROBOT_DAYS = 3650, 1095
_SERVER_DAYS = 820  # some browsers take none that is good for more than 825
_CLOCKS_BEHIND = datetime.timedelta(days=1)  # of machines that start without knowing the time
_LONGEST_LABEL = 63


@dataclass(frozen=True, slots=True)
class Pair:
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def authority() -> Pair:
    """Return a new authority, good for ten years."""
    key = _key()
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    builder = _builder(_AUTHORITY_NAME, key, _name(_AUTHORITY_NAME), _AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(signs_certificates=True), critical=True)
    return Pair(builder.add_extension(identifier, critical=False).sign(key, hashes.SHA256()), key)


def server(by: Pair, names: x509.SubjectAlternativeName) -> Pair:
    """Return a new certificate for the server, good for two years."""
    builder, key = _leaf(by, _SERVER_NAME, _SERVER_DAYS, ExtendedKeyUsageOID.SERVER_AUTH)
    return Pair(builder.add_extension(names, critical=False).sign(by.key, hashes.SHA256()), key)


def robot(by: Pair, name: str) -> Pair:
    """Return a new certificate for a robot, good for three years."""
    names = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(f"urn:revnm:robot:{name}")])
    builder, key = _leaf(by, name, _ROBOT_DAYS, ExtendedKeyUsageOID.CLIENT_AUTH)
    return Pair(builder.add_extension(names, critical=False).sign(by.key, hashes.SHA256()), key)


def alternative_names(hosts: Sequence[str]) -> x509.SubjectAlternativeName:
    """Return the names of a server.

    Args:
        hosts: Names and addresses, such as ``edge.local``, ``192.168.1.5``.

    Raises:
        ConfigError: A host is no name or address, or there is none.
    """
    if not hosts:
        raise ConfigError("no host: expected the names and addresses by which robots reach the server")
    return x509.SubjectAlternativeName([_alternative_name(host) for host in hosts])


def _alternative_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.removeprefix("[").removesuffix("]")))
    except ValueError:
        labels = host.split(".")
        if labels[-1].isdigit() or not all(map(_is_label, labels)):
            expected = "a name or an address, such as edge.local or 192.168.1.5"
            raise ConfigError(f"host {host!r:.80}: expected {expected}") from None
        return x509.DNSName(host)


def _is_label(text: str) -> bool:
    """Whether a text can stand between the dots of a host's name."""
    plain = text.isascii() and text.replace("-", "").isalnum()
    return plain and len(text) <= _LONGEST_LABEL and not text.startswith("-") and not text.endswith("-")


def _leaf(
    by: Pair, name: str, days: int, purpose: x509.ObjectIdentifier
) -> tuple[x509.CertificateBuilder, ec.EllipticCurvePrivateKey]:
    key = _key()
    issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(by.key.public_key())
    builder = _builder(name, key, by.certificate.subject, days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(signs_certificates=False), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
    return builder.add_extension(issuer, critical=False), key


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _builder(name: str, key: ec.EllipticCurvePrivateKey, issuer: x509.Name, days: int) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return x509.CertificateBuilder(
        issuer_name=issuer,
        subject_name=_name(name),
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
        not_valid_before=now - _CLOCKS_BEHIND,
        not_valid_after=now + datetime.timedelta(days=days),
    )


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())
