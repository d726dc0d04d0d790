"""Heads of LAS files that are sound, and not as their readers wish them."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

__all__ = ["plain_source"]

# Bytes of the head of a record before the points.
RECORD_HEAD = 54


def plain_source(path):
    """What to give to the reader of LAS: the path, or a copy with plain letters in its names.

    Letters beside ASCII in identifiers and descriptions are replaced by question marks there.
    """
    with Path(path).open("rb") as file:
        start, points, records = struct.unpack("<94xHII", file.read(104))
        file.seek(0)
        before = bytearray(file.read(points))
        spans, at = [slice(26, 90)], start
        for _ in range(records):
            spans += [slice(at + 2, at + 18), slice(at + 22, at + RECORD_HEAD)]
            at += RECORD_HEAD + struct.unpack("<H", before[at + 20 : at + 22])[0]
        if all(bytes(before[span]).isascii() for span in spans):
            return path
        for span in spans:
            before[span] = bytes(byte if byte < 128 else ord("?") for byte in before[span])
        return BytesIO(bytes(before) + file.read())
