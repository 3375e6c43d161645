"""LZFSE (Apple's compression) with a limit: how much a block unpacks to is read before anything is unpacked.

Block layout: https://github.com/lzfse/lzfse, lzfse_internal.h. The package `lzfse` does the unpacking; alone it would
unpack whatever it is given, to any size.
"""

import struct

from realsim.core.errors import extra

END = b"bvx$"


def require() -> None:
    """Raise MissingExtraError if the package is not installed."""
    extra("lzfse", "phone", "reading the depth of Record3D's .r3d files")


def decompress(data: bytes, size: int) -> bytes:
    """The `size` bytes that `data` unpack to.

    Raises:
        ValueError: damaged, or of another size.
        MissingExtraError: the package `lzfse` is not installed.
    """
    require()
    import lzfse

    promised = unpacked_size(data)
    if promised != size:
        raise ValueError(f"the compressed data unpack to {promised} bytes instead of {size}")
    try:
        out: bytes = lzfse.decompress(data)
    except lzfse.error as error:
        raise ValueError("the compressed data are damaged") from error
    if len(out) != size:
        raise ValueError(f"the compressed data unpack to {len(out)} bytes instead of {size}")
    return out


def unpacked_size(data: bytes) -> int:
    """Sum of what the blocks say that they unpack to.

    Raises:
        ValueError: the blocks do not follow each other to the end mark.
    """
    at = total = 0
    try:
        while (kind := data[at : at + 4]) != END:
            (raw,) = struct.unpack_from("<I", data, at + 4)
            if kind == b"bvx-":
                at += 8 + raw
            elif kind == b"bvxn":
                at += 12 + struct.unpack_from("<I", data, at + 8)[0]
            elif kind == b"bvx2":
                literals, matches, header = struct.unpack_from("<QQQ", data, at + 8)
                # Bits 20 to 39 and 40 to 59 hold the payload sizes, the low half of the last word the header's own.
                at += (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF) + max(header & 0xFFFFFFFF, 32)
            else:
                raise ValueError("the compressed data are damaged, or not LZFSE")
            total += raw
    except struct.error as error:
        raise ValueError("the compressed data end early") from error
    return total
