"""Ways to damage a capture, and what is said of it."""


def reason(capture, name: str) -> str:
    """Why the frame of that name was dropped; also that only it was."""
    assert [d.name for d in capture.dropped] == [name]
    assert name not in {f.name for f in capture.frames}
    return capture.dropped[0].reason


def cut(path, share=0.6):
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
