"""Bytes of a log damaged in place, as disks, cables and power cuts damage them; no checksum is mended."""

from collections.abc import Callable
from random import Random

Harm = Callable[[bytes, Random], bytes]

LENGTHS = (0, 1, 8, 2**16, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
"""What a length may say that has gone wrong."""


def _span(data: bytes, rng: Random, most: int = 4096) -> tuple[int, int]:
    start = rng.randrange(len(data))
    return start, min(len(data), start + rng.choice((1, 2, 8, 100, most)))


def _record(data: bytes, rng: Random) -> tuple[int, int]:
    """Give where one of the records starts and ends, every kind equally likely."""
    found: dict[int, list[tuple[int, int]]] = {}
    start = 8
    while start + 9 <= len(data) - 8:
        end = start + 9 + int.from_bytes(data[start + 1 : start + 9], "little")
        if end > len(data):
            break
        found.setdefault(data[start], []).append((start, end))
        start = end
    if not found:
        return _span(data, rng)
    return rng.choice(found[rng.choice(sorted(found))])


def _over(data: bytes, start: int, new: bytes) -> bytes:
    return data[:start] + new + data[start + len(new) :]


def flip_bit(data: bytes, rng: Random) -> bytes:
    """Flip one bit."""
    place = rng.randrange(len(data))
    return _over(data, place, bytes([data[place] ^ 1 << rng.randrange(8)]))


def flip_in_record(data: bytes, rng: Random) -> bytes:
    """Flip one bit of a record of any kind, and so often of a small one."""
    place = rng.randrange(*_record(data, rng))
    return _over(data, place, bytes([data[place] ^ 1 << rng.randrange(8)]))


def noise(data: bytes, rng: Random) -> bytes:
    """Write noise over a span."""
    start, end = _span(data, rng)
    return _over(data, start, rng.randbytes(end - start))


def zeros(data: bytes, rng: Random) -> bytes:
    """Write zeros over a span, as a disk does that lost a block."""
    start, end = _span(data, rng)
    return _over(data, start, bytes(end - start))


def ones(data: bytes, rng: Random) -> bytes:
    """Write ones over a span, as erased flash reads."""
    start, end = _span(data, rng)
    return _over(data, start, b"\xff" * (end - start))


def cut_end(data: bytes, rng: Random) -> bytes:
    """Lose the end."""
    return data[: rng.randrange(len(data))]


def cut_few(data: bytes, rng: Random) -> bytes:
    """Lose the last bytes."""
    return data[: -rng.randrange(1, min(len(data), 400))]


def cut_start(data: bytes, rng: Random) -> bytes:
    """Lose the start."""
    return data[rng.randrange(1, len(data)) :]


def zero_end(data: bytes, rng: Random) -> bytes:
    """Keep the length but not the end, as after a power cut."""
    start = rng.randrange(len(data))
    return data[:start] + bytes(len(data) - start)


def cut_out(data: bytes, rng: Random) -> bytes:
    """Lose a span."""
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def insert_noise(data: bytes, rng: Random) -> bytes:
    """Put noise in between."""
    start = rng.randrange(len(data) + 1)
    return data[:start] + rng.randbytes(rng.choice((1, 9, 500))) + data[start:]


def repeat_span(data: bytes, rng: Random) -> bytes:
    """Write a span twice."""
    start, end = _span(data, rng)
    return data[:end] + data[start:]


def swap_spans(data: bytes, rng: Random) -> bytes:
    """Exchange two pieces of one length."""
    size = rng.choice((1, 16, 512, 4096))
    if len(data) < 2 * size:
        return data[::-1]
    one = rng.randrange(len(data) - 2 * size + 1)
    two = rng.randrange(one + size, len(data) - size + 1)
    return (
        data[:one]
        + data[two : two + size]
        + data[one + size : two]
        + data[one : one + size]
        + data[two + size :]
    )


def drop_record(data: bytes, rng: Random) -> bytes:
    """Lose a whole record."""
    start, end = _record(data, rng)
    return data[:start] + data[end:]


def repeat_record(data: bytes, rng: Random) -> bytes:
    """Write a whole record twice."""
    start, end = _record(data, rng)
    return data[:end] + data[start:]


def move_record(data: bytes, rng: Random) -> bytes:
    """Put a record where another one starts."""
    start, end = _record(data, rng)
    rest, (place, _) = data[:start] + data[end:], _record(data, rng)
    return rest[:place] + data[start:end] + rest[place:]


def change_kind(data: bytes, rng: Random) -> bytes:
    """Call a record something else."""
    return _over(data, _record(data, rng)[0], bytes([rng.randrange(256)]))


def change_length(data: bytes, rng: Random) -> bytes:
    """Let a record say a wrong length."""
    start, end = _record(data, rng)
    length = rng.choice((*LENGTHS, end - start - 10, end - start - 8))
    return _over(data, start + 1, max(length, 0).to_bytes(8, "little"))


def change_inner_length(data: bytes, rng: Random) -> bytes:
    """Write a length over four bytes near a record's start, where its own lengths stand."""
    start, end = _record(data, rng)
    place = min(start + 9 + rng.randrange(48), max(end - 4, start))
    return _over(data, place, (rng.choice(LENGTHS) & 0xFFFFFFFF).to_bytes(4, "little"))


def change_magic(data: bytes, rng: Random) -> bytes:
    """Damage the first or the last bytes."""
    place = rng.choice((0, len(data) - 8)) + rng.randrange(8)
    return _over(data, max(place, 0), rng.randbytes(1))


def append_noise(data: bytes, rng: Random) -> bytes:
    """Put something behind the end."""
    return data + rng.choice((rng.randbytes(50), bytes(4096), data[:8], data))


HARMS: tuple[Harm, ...] = (
    *(
        flip_bit,
        flip_in_record,
        noise,
        zeros,
        ones,
        cut_end,
        cut_few,
        cut_start,
        zero_end,
        cut_out,
        insert_noise,
    ),
    *(
        repeat_span,
        swap_spans,
        drop_record,
        repeat_record,
        move_record,
        change_kind,
        change_length,
    ),
    *(change_inner_length, change_magic, append_noise),
)


def harmed(data: bytes, rng: Random) -> tuple[str, bytes]:
    """Damage a log in one place, and one time in four in two or three.

    Returns
    -------
    str
        What was done.
    bytes
    """
    names = []
    for _ in range(rng.choice((1, 1, 1, 1, 1, 1, 2, 3))):
        harm = rng.choice(HARMS)
        data = harm(data, rng) if len(data) > 16 else data
        names.append(harm.__name__)
    return " + ".join(names), data
