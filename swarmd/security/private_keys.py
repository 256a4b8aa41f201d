"""Private keys of P-256 in PEM files."""

from __future__ import annotations

from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from swarmd.core.errors import ConfigError
from swarmd.core.files import read_regular


def public_bytes(key: ec.EllipticCurvePublicKey) -> bytes:
    """A public key as `x || y`, 64 bytes."""
    return key.public_bytes(
        serialization.Encoding.X962, serialization.PublicFormat.UncompressedPoint
    )[1:]


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
