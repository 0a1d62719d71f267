"""Damaged copies of valid files: cut, flipped, shuffled, and with absurd values in their fields."""

from __future__ import annotations

import struct

import numpy as np

NUMBERS = (
    0.0,
    -0.0,
    -1.0,
    np.nan,
    np.inf,
    -np.inf,
    1e308,
    -1e308,
    1e150,
    5e-324,
    1e-30,
    2.0**63,
    1e12,
)
ABSURD_BYTES = (
    *(struct.pack("<d", value) for value in NUMBERS),
    *(struct.pack("<f", value) for value in (np.nan, np.inf, -1.0, 0.0, 3e38)),
    *(struct.pack("<Q", value) for value in (0, 1, 2**31, 2**32, 2**48, 2**62, 2**63, 2**64 - 1)),
    *(struct.pack("<I", value) for value in (0, 1, 2, 2**16, 2**31 - 1, 2**31, 2**32 - 1)),
    *(struct.pack(">I", value) for value in (0, 1, 2**16, 2**31 - 1, 2**32 - 1)),
    *(bytes([value]) for value in (0, 1, 0x0A, 0x20, 0x7F, 0x80, 0xFF)),
)
ABSURD_WORDS = (
    *(
        b"nan",
        b"inf",
        b"-inf",
        b"1e999",
        b"1e150",
        b"1e308",
        b"-1e308",
        b"1e-400",
        b"0",
        b"-0.0",
        b"-1",
    ),
    *(b"2147483648", b"4294967296", b"18446744073709551615", b"9" * 40, b"1000000000000", b"0x10"),
    *(
        b"",
        b"abc",
        b"../../escape.png",
        b"/etc/passwd",
        b"\0",
        "\u00e9\u4e16".encode(),
        b"\xff\xfe",
    ),
    *(b"null", b"true", b"[]", b"{}", b"[[[[[[", b'"', b"#", b"1,5", b"1_000", b" " * 300, b"\n\n"),
)


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """`data` after one to three random acts of damage."""
    is_text = b"\0" not in data[:4000]
    acts = TEXT_ACTS if is_text and rng.random() < 0.7 else BYTE_ACTS
    for _ in range(rng.integers(1, 4)):
        data = acts[rng.integers(len(acts))](data, rng)
    return data


def place(size: int, rng: np.random.Generator) -> int:
    """A place below `size`; every other time near the start, where headers and counts are."""
    limit = min(size, 120) if rng.random() < 0.5 else size
    return int(rng.integers(max(limit, 1)))


def span(size: int, rng: np.random.Generator) -> slice:
    """Some bytes, mostly few."""
    start = place(size, rng)
    return slice(start, start + 1 + int(rng.exponential(12)))


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: place(len(data), rng)]


def flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        if changed:
            changed[place(len(changed), rng)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def write_absurd(data: bytes, rng: np.random.Generator) -> bytes:
    value = ABSURD_BYTES[rng.integers(len(ABSURD_BYTES))]
    start = place(len(data), rng)
    if rng.random() < 0.5:
        start -= start % len(value)
    return data[:start] + value + data[start + len(value) :]


def remove(data: bytes, rng: np.random.Generator) -> bytes:
    part = span(len(data), rng)
    return data[: part.start] + data[part.stop :]


def repeat(data: bytes, rng: np.random.Generator) -> bytes:
    part = span(len(data), rng)
    return data[: part.stop] + data[part] * int(rng.integers(1, 5)) + data[part.stop :]


def insert_noise(data: bytes, rng: np.random.Generator) -> bytes:
    start = place(len(data), rng)
    return data[:start] + rng.bytes(int(rng.integers(1, 40))) + data[start:]


def zero(data: bytes, rng: np.random.Generator) -> bytes:
    part = span(len(data), rng)
    return data[: part.start] + bytes(len(data[part])) + data[part.stop :]


def forget(data: bytes, rng: np.random.Generator) -> bytes:
    return (b"", data[:1], rng.bytes(200), b"\n" * 50)[rng.integers(4)]


def change_words(data: bytes, rng: np.random.Generator) -> bytes:
    """Absurd words in the place of some words of one line."""
    lines = data.split(b"\n")
    row = place_of_line(lines, rng)
    words = lines[row].split(b" ")
    for _ in range(rng.integers(1, 4)):
        words[rng.integers(len(words))] = ABSURD_WORDS[rng.integers(len(ABSURD_WORDS))]
    lines[row] = b" ".join(words)
    return b"\n".join(lines)


def change_token(data: bytes, rng: np.random.Generator) -> bytes:
    """An absurd word in the place of what lies between two signs of JSON, TOML or a table."""
    start = place(len(data), rng)
    end = start
    while end < len(data) and data[end : end + 1] not in b' ,:=[]{}"\n\t':
        end += 1
    return data[:start] + ABSURD_WORDS[rng.integers(len(ABSURD_WORDS))] + data[end:]


def drop_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    del lines[place_of_line(lines, rng)]
    return b"\n".join(lines)


def repeat_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    row = place_of_line(lines, rng)
    return b"\n".join(lines[: row + 1] + lines[row:])


def swap_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    first, second = place_of_line(lines, rng), place_of_line(lines, rng)
    lines[first], lines[second] = lines[second], lines[first]
    return b"\n".join(lines)


def place_of_line(lines: list[bytes], rng: np.random.Generator) -> int:
    return int(rng.integers(min(len(lines), 12) if rng.random() < 0.5 else len(lines)))


BYTE_ACTS = (cut, flip_bits, write_absurd, write_absurd, remove, repeat, insert_noise, zero, forget)
TEXT_ACTS = (
    *(change_words, change_words, change_token, change_token, drop_line, repeat_line, swap_lines),
    *(cut, flip_bits, remove, repeat, insert_noise),
)
