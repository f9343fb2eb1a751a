"""The attack on AES-GCM that a nonce used twice opens: a frame is forged without the key.

Two frames with one nonce, of one block each, differ in one block D of the ciphertext and in their
tags. With the hash key H, tag = D H^2 + (the same for both), so H^2 = difference of tags / D; a
square root in GF(2^128) is 127 squarings. The plaintext known of one frame gives the key stream.

Source: Joux, Authentication failures in NIST version of GCM (2006); field of NIST SP 800-38D.
"""

from tests.support.sdls_sender import with_fecf

R = 0xE1 << 120
DATA_AT, MAC_BYTES, FECF_BYTES, BLOCK = 19, 16, 2, 16


def multiply(x: int, y: int) -> int:
    """Multiply in GF(2^128), bits in the order of SP 800-38D."""
    product = 0
    for bit in range(127, -1, -1):
        if x >> bit & 1:
            product ^= y
        y = y >> 1 ^ (R if y & 1 else 0)
    return product


def invert(x: int) -> int:
    """Return x^(2^128 - 2)."""
    result, power = 1 << 127, x
    for _ in range(127):
        power = multiply(power, power)
        result = multiply(result, power)
    return result


def square_root(x: int) -> int:
    """Return x^(2^127)."""
    for _ in range(127):
        x = multiply(x, x)
    return x


def parts(frame: bytes) -> tuple[bytes, bytes]:
    """Return ciphertext and tag."""
    return (
        frame[DATA_AT : -MAC_BYTES - FECF_BYTES],
        frame[-MAC_BYTES - FECF_BYTES : -FECF_BYTES],
    )


def block(data: bytes) -> int:
    """Return up to 16 bytes as a field element."""
    return int.from_bytes(data.ljust(BLOCK, b"\0"), "big")


def forge_from_one_nonce(first: bytes, second: bytes, known: bytes, wanted: bytes) -> bytes:
    """Return the frame of `wanted`, from two frames and the plaintext of the first.

    All three packets have the same length, at most one block.
    """
    (cipher_1, tag_1), (cipher_2, tag_2) = parts(first), parts(second)
    difference = block(cipher_1) ^ block(cipher_2)
    hash_key = square_root(multiply(block(tag_1) ^ block(tag_2), invert(difference)))
    stream = bytes(a ^ b for a, b in zip(cipher_1, known, strict=True))
    cipher = bytes(a ^ b for a, b in zip(stream, wanted, strict=True))
    change = block(cipher) ^ block(cipher_1)
    tag = block(tag_1) ^ multiply(change, multiply(hash_key, hash_key))
    return with_fecf(first[:DATA_AT] + cipher + tag.to_bytes(MAC_BYTES, "big"))
