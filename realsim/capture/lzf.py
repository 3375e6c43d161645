"""LZF decompression (M. Lehmann's liblzf format), as PCD's `binary_compressed` uses it.

A control byte below 32 is followed by that many literal bytes plus one; any other names a copy of what is already
decompressed: three bits of length (7: another byte follows), 13 bits of distance.
"""


def decompress(data: bytes, size: int) -> bytes:
    """The `size` bytes that `data` unpack to.

    Raises:
        ValueError: the data are damaged: they end early, refer to what is not there, or unpack to another size.
    """
    out = bytearray()
    at, end = 0, len(data)
    try:
        while at < end:
            control = data[at]
            at += 1
            if control < 32:
                literal = data[at : at + control + 1]
                out += literal
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            _copy(out, start, length + 2)
            if len(out) > size:
                break
    except IndexError as error:
        raise ValueError("the compressed data end early") from error
    if len(out) != size or at != end:
        raise ValueError(f"the compressed data unpack to {len(out)} bytes instead of {size}")
    return bytes(out)


def _copy(out: bytearray, start: int, length: int) -> None:
    """Append `length` bytes of `out` from `start` on; the source may run into what is being appended."""
    if start < 0:
        raise ValueError("the compressed data refer to missing data")
    chunk = out[start : start + length]
    if len(chunk) < length:
        chunk = (chunk * (length // len(chunk) + 1))[:length]
    out += chunk
