"""Signatures of goals, manifests and rosters."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from swarmd.link.keys.content_signature import ORDER, Purpose, has_form, is_signed_by, sign
from swarmd.link.keys.private_keys import public_bytes
from tests.support.keys import flipped

KEY = ec.generate_private_key(ec.SECP256R1())
PUBLIC = public_bytes(KEY.public_key())


def test_signatures_have_the_smaller_s_and_the_other_one_is_refused() -> None:
    for number in range(32):  # a signer that does not choose passes this once in 2**32
        content = bytes([number])
        signature = sign(KEY, Purpose.GOAL, content)
        assert int.from_bytes(signature[32:], "big") <= ORDER // 2
        assert has_form(signature)
        assert not has_form(flipped(signature))
    assert is_signed_by(PUBLIC, Purpose.GOAL, content, signature)
    assert not is_signed_by(PUBLIC, Purpose.GOAL, content, flipped(signature))


@pytest.mark.parametrize("purpose", Purpose)
def test_a_signature_is_of_one_purpose_alone(purpose: Purpose) -> None:
    signature = sign(KEY, purpose, b"content")
    assert [one for one in Purpose if is_signed_by(PUBLIC, one, b"content", signature)] == [purpose]


def test_no_purpose_begins_with_another() -> None:
    for one in Purpose:
        assert not any(two.value.startswith(one.value) for two in Purpose if two is not one)


@pytest.mark.parametrize("wrong", [b"", bytes(63), bytes(64), bytes(65), b"\xff" * 64])
def test_what_is_no_signature_is_refused(wrong: bytes) -> None:
    assert not is_signed_by(PUBLIC, Purpose.GOAL, b"content", wrong)


def test_a_signature_of_the_key_without_a_purpose_is_refused() -> None:
    """As TLS makes them with the same key."""
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

    r, s = decode_dss_signature(KEY.sign(b"content", ec.ECDSA(hashes.SHA256())))
    signature = r.to_bytes(32, "big") + min(s, ORDER - s).to_bytes(32, "big")
    assert not any(is_signed_by(PUBLIC, one, b"content", signature) for one in Purpose)


@pytest.mark.parametrize("key", [b"", bytes(64), b"\xff" * 64, bytes(65)])
def test_what_is_no_public_key_verifies_nothing(key: bytes) -> None:
    signature = sign(KEY, Purpose.GOAL, b"content")
    assert not is_signed_by(key, Purpose.GOAL, b"content", signature)
