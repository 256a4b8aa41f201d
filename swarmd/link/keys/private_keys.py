"""Private keys of P-256 in PEM files."""

from __future__ import annotations

from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from swarmd.core.errors import ConfigError
from swarmd.core.files import read_regular


def public_bytes(key: ec.EllipticCurvePublicKey) -> bytes:
    """A public key as `x || y`, 64 bytes."""
    return key.public_bytes(
        serialization.Encoding.X962, serialization.PublicFormat.UncompressedPoint
    )[1:]


def holder_of(certificate: bytes, authority: bytes) -> tuple[str, bytes]:
    """The name in a certificate (PEM) and its public key, if `authority` (`x || y`) has signed it.

    An empty name and key for any other bytes. The time of the certificate is not checked: the wall
    clocks of robots may be wrong, and a roster revokes names.
    """
    try:
        found = x509.load_pem_x509_certificate(certificate)
        issuer = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x04" + authority)
        issuer.verify(found.signature, found.tbs_certificate_bytes, ec.ECDSA(hashes.SHA256()))
        name = found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value
        key = found.public_key()
        if not isinstance(key, ec.EllipticCurvePublicKey):
            raise TypeError("not a key of a curve")
    except (InvalidSignature, UnsupportedAlgorithm, ValueError, IndexError, TypeError):
        return "", b""
    return (
        (str(name), public_bytes(key)) if isinstance(key, ec.EllipticCurvePublicKey) else ("", b"")
    )


def load_private_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """The private key of an identity, with which an operator signs. ConfigError in one line."""
    return load_key(path, None)


def load_key(path: Path, passphrase: bytes | None) -> ec.EllipticCurvePrivateKey:
    """The private key in a PEM file. ConfigError in one line."""
    try:
        key = serialization.load_pem_private_key(read_regular(path), passphrase)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except (TypeError, ValueError, UnsupportedAlgorithm) as error:
        if passphrase:
            raise ConfigError(f"{path}: the passphrase is wrong, or the file is damaged") from None
        raise ConfigError(f"{path}: {error}") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.curve.name != ec.SECP256R1.name:
        raise ConfigError(f"{path}: expected a key of the curve P-256")
    return key


def pem_of(key: ec.EllipticCurvePrivateKey, passphrase: bytes | None) -> bytes:
    """A private key as PEM (PKCS #8), encrypted if there is a passphrase."""
    encryption: serialization.KeySerializationEncryption = serialization.NoEncryption()
    if passphrase:
        encryption = serialization.BestAvailableEncryption(passphrase)
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption
    )
