"""Real captures of others for the tests of readers: a few files each, of public repositories with permissive licences.

    python tools/fetch_samples.py --out samples          # 12 MB
    REALSIM_SHARED=samples pytest tests/capture -k "boxes or stairs or room or above"

Every file is of a fixed commit and has to have the checksum that stands in samples.json. Files are not changed: a frame
that was written anew would test this toolkit's writer. The licence lies beside the files. What is there already, with
the right checksum, is not fetched again.
"""

import argparse
import hashlib
import json
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from realsim.core.errors import RealsimError
from realsim.core.files import inside, write_bytes, write_text
from realsim.core.progress import track

SAMPLES: dict[str, Any] = json.loads(Path(__file__).with_name("samples.json").read_text())
"""Name -> repo, commit, licence, what it is, and path in the repository -> SHA-256."""
URL = "https://raw.githubusercontent.com/{repo}/{commit}/{path}"
MAX_BYTES = 16 * 2**20
SECONDS = 60


def fetch(url: str) -> bytes:
    """The content of a URL, at most MAX_BYTES of it."""
    try:
        with urllib.request.urlopen(url, timeout=SECONDS) as answer:
            data: bytes = answer.read(MAX_BYTES + 1)
    except (urllib.error.URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise RealsimError("cannot be fetched", file=url, found=str(reason), hint="check the network") from error
    if len(data) > MAX_BYTES:
        raise RealsimError("the file is too large", file=url, expected=f"at most {MAX_BYTES} bytes")
    return data


def fetch_sample(name: str, out: Path, url: str = URL, samples: dict[str, Any] = SAMPLES) -> Path:
    """The files of one sample in `out`/real_captures/NAME, where the tests look for them.

    Args:
        url: where a file is, with {repo}, {commit}, {path} and {name}; a mirror, or a folder by file://.

    Raises:
        RealsimError: a file cannot be fetched, or is not the one that is meant; those before it stay.
    """
    sample = samples[name]
    folder = out / "real_captures" / name
    for path, expected in track(sample["files"].items(), name):
        target = inside(folder, path)
        if target.is_file() and hashlib.sha256(target.read_bytes()).hexdigest() == expected:
            continue
        place = url.format(name=name, path=path, repo=sample["repo"], commit=sample["commit"])
        data = fetch(place)
        found = hashlib.sha256(data).hexdigest()
        if found != expected:
            raise RealsimError("not the file that is meant", file=place, expected=f"SHA-256 {expected}", found=found)
        write_bytes(target, data)
    source = f"https://github.com/{sample['repo']} at {sample['commit']}\n{sample['licence']}\n{sample['what']}\n"
    write_text(folder / "SOURCE.txt", source)
    return folder


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help=f"some of {', '.join(SAMPLES)}; all if none is named")
    parser.add_argument("--out", type=Path, default=Path("samples"))
    parser.add_argument("--url", default=URL, help="a mirror, with {repo}, {commit}, {path} and {name}")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.names if name not in SAMPLES]
    if unknown:
        parser.error(f"no such sample: {', '.join(unknown)}")
    try:
        for name in arguments.names or SAMPLES:
            print(fetch_sample(name, arguments.out, arguments.url))
    except RealsimError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"now: REALSIM_SHARED={arguments.out} pytest tests/capture")
    return 0


if __name__ == "__main__":
    sys.exit(main())
