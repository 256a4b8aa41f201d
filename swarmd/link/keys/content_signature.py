"""Signatures of goals, manifests, rosters, incidents and marks: ECDSA with P-256 and SHA-256.

FIPS 186-5. A signature has 64 bytes, `r || s`, big endian.

The private key of an operator also signs TLS handshakes, that of the authority also certificates.
So the signed bytes begin with the purpose: a signature for one purpose is not valid for another.

If (r, s) is a signature, so is (r, n - s), where n is the order of the curve. `verify` accepts only
the signature with the smaller s, so that nobody can make a second signature without the key.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

SIGNATURE_BYTES = 64
ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
"""n, the order of the base point of P-256 (SEC 2, 2.4.2)."""


class Purpose(Enum):
    """The kinds of signed content; the value precedes the content."""

    GOAL = b"swarmd goal\0"
    MANIFEST = b"swarmd pattern\0"
    ROSTER = b"swarmd roster\0"
    INCIDENT = b"swarmd incident\0"
    MARK = b"swarmd mark\0"


def sign(key: EllipticCurvePrivateKey, purpose: Purpose, content: bytes) -> bytes:
    """The signature of `content`."""
    from cryptography.hazmat.primitives import hashes  # 13 ms, for keys alone
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

    r, s = decode_dss_signature(key.sign(purpose.value + content, ec.ECDSA(hashes.SHA256())))
    return r.to_bytes(32, "big") + min(s, ORDER - s).to_bytes(32, "big")


def has_form(signature: bytes) -> bool:
    """True if these bytes have the form of a signature: 64 bytes, with the smaller s."""
    return len(signature) == SIGNATURE_BYTES and int.from_bytes(signature[32:], "big") <= ORDER // 2


def is_signed_by(
    public_key: bytes | None, purpose: Purpose, content: bytes, signature: bytes
) -> bool:
    """True if the holder of `public_key` (`x || y`) has made `signature` of `content`.

    False without a key.
    """
    if public_key is None or not has_form(signature):
        return False
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives import hashes  # 13 ms, for keys alone
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

    r = int.from_bytes(signature[:32], "big")
    s = int.from_bytes(signature[32:], "big")
    try:
        key = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x04" + public_key)
        key.verify(encode_dss_signature(r, s), purpose.value + content, ec.ECDSA(hashes.SHA256()))
    except (InvalidSignature, ValueError):
        return False
    return True
