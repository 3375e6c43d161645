"""Input format and output meaning of a model file: read from the file, from a sidecar, or guessed.

Every value remembers where it came from, because a guess that is wrong gives a wrong scene without an error.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from realsim.core.errors import ModelError, UnknownNameError
from realsim.core.files import read_json
from realsim.feedforward.onnx.adapters import ADAPTERS, Adapter

CHOICES: dict[str, tuple[str, ...]] = {
    "norm": ("identity", "imagenet", "half"),
    "fit": ("resize", "pad_white", "crop"),
    "pose": ("c2w", "w2c", "pose_enc9", "raw9"),
    "conf": ("logit", "exp1", "log_error", "none"),
    "scale": ("none", "applied", "factor"),
}
IMAGE_NAMES = ("images", "imgs", "input_images", "image")
OTHER_INPUTS = ("depths", "intrinsics", "poses", "num_tokens")


@dataclass(frozen=True)
class Port:
    """An input or output as declared; what a shape says may be wrong (`runner` judges by what comes out)."""

    name: str
    shape: tuple[int | str | None, ...]
    type: str

    def __str__(self) -> str:
        return f"{self.name} {self.type.removeprefix('tensor(').removesuffix(')')}{list(self.shape)}".replace("'", "")


@dataclass(frozen=True)
class Spec:
    """The contract as one model fills it in."""

    kind: str
    """Name of the adapter of its outputs."""
    image: Port
    """The input that takes the images."""
    ports: Mapping[str, str]
    """Role of an output -> its name in the file."""
    extra_inputs: tuple[Port, ...] = ()
    norm: str = "identity"
    patch: int = 14
    fit: str = "resize"
    fixed_hw: tuple[int, int] | None = None
    max_views: int | None = None
    n_static: int | None = None
    pose: str = "c2w"
    conf: str = "none"
    scale: str = "none"
    origin: Mapping[str, str] = field(default_factory=dict)
    """Key -> metadata, sidecar, graph, guessed, or default where absence says enough."""

    @property
    def batched(self) -> bool:
        """Whether images go in as (1, N, 3, H, W), not (N, 3, H, W)."""
        return len(self.image.shape) == 5

    @property
    def guessed(self) -> tuple[str, ...]:
        """`key value` of everything that the file does not say."""
        return tuple(f"{k} {getattr(self, k)}" for k, how in self.origin.items() if how == "guessed")


def make_spec(path: Path, metadata: Mapping[str, str], inputs: list[Port], outputs: list[Port]) -> Spec:
    """Match a file's ports and metadata with the contract.

    Raises:
        ModelError: no input for images, an input that nothing can be given for, outputs that no adapter reads, or a
            value that the contract does not know.
    """
    image = _image_input(path, inputs)
    extra = tuple(p for p in inputs if p is not image)
    strange = [str(p) for p in extra if p.name not in OTHER_INPUTS]
    if strange:
        raise ModelError(
            "the model has inputs that the contract does not know",
            file=path,
            expected=f"images ({', '.join(IMAGE_NAMES)}) and at most {', '.join(OTHER_INPUTS)}",
            found=", ".join(strange),
        )
    given = _given(path, metadata)
    names = [p.name for p in outputs]
    kind, how = _kind(path, given, outputs)
    ports = ADAPTERS[kind].match(names)
    if missing := [role for role in ADAPTERS[kind].needs if role not in ports]:
        raise ModelError(
            f"the outputs do not make a model of kind {kind}",
            file=path,
            expected=", ".join(f"{r} ({' or '.join(ADAPTERS[kind].needs[r])})" for r in missing),
            found=", ".join(map(str, outputs)),
            hint=f"closest is the kind {closest(names)[0]}; set kind in {sidecar(path).name}",
        )
    values: dict[str, Any] = {"kind": kind}
    origin = {"kind": how}
    for key, guess in _guesses(kind, ports, image).items():
        values[key], origin[key] = given.get(key, guess)
        if guess[1] == "graph" and key in given and guess[0] is not None and given[key][0] != guess[0]:
            raise ModelError(
                f"the file contradicts itself about {key}", file=path,
                expected=f"{guess[0]}, as the input {image} has it", found=f"{given[key][0]} ({given[key][1]})",
            )  # fmt: skip
    return Spec(image=image, ports=ports, extra_inputs=extra, origin=origin, **values)


def sidecar(path: Path) -> Path:
    """Hint for a file without metadata."""
    return path.with_suffix(".json")


def closest(names: list[str]) -> tuple[str, Adapter]:
    """The adapter that finds the largest share of what it needs among output names."""
    return max(((k, ADAPTERS[k]) for k in ADAPTERS), key=lambda item: item[1].share(names))


def _image_input(path: Path, inputs: list[Port]) -> Port:
    for name in IMAGE_NAMES:
        for port in inputs:
            if port.name == name:
                channels = port.shape[-3] if len(port.shape) in (4, 5) else 0
                if len(port.shape) in (4, 5) and (channels == 3 or not isinstance(channels, int)):
                    return port
    raise ModelError(
        "the model has no input for images",
        file=path,
        expected=f"{' or '.join(IMAGE_NAMES)} of shape (1, N, 3, H, W) or (N, 3, H, W)",
        found=", ".join(map(str, inputs)) or "no inputs",
        hint="a policy is run by `realsim deploy`" if any(port.name == "vector" for port in inputs) else None,
    )


def _kind(path: Path, given: Mapping[str, tuple[Any, str]], outputs: list[Port]) -> tuple[str, str]:
    names = [p.name for p in outputs]
    if "kind" in given:
        return given["kind"]
    # The adapters stand in the order in which they are believed: what a file has more of comes first.
    for kind in ADAPTERS:
        if ADAPTERS[kind].share(names) == 1:
            return kind, "guessed"
    kind, adapter = closest(names)
    lacking = [role for role in adapter.needs if role not in adapter.match(names)]
    raise ModelError(
        "the model's outputs do not fit the contract",
        file=path,
        expected="; or ".join(f"{k}: {', '.join(ADAPTERS[k].needs)}" for k in ADAPTERS),
        found=", ".join(map(str, outputs)),
        hint=f"closest is the kind {kind}, which lacks {', '.join(lacking)}",
    )


def _guesses(kind: str, ports: Mapping[str, str], image: Port) -> dict[str, tuple[Any, str]]:
    """Key -> (value, origin) of keys without a value: the convention of published exports of each kind."""
    h, w = image.shape[-2:]
    n = image.shape[1] if len(image.shape) == 5 else image.shape[0]
    fixed = (h, w) if isinstance(h, int) and isinstance(w, int) else None
    static = n if isinstance(n, int) else None
    pose = ports.get("pose", "")
    vggt, claims = pose == "pose_enc", "metric_scale" in ports
    # Pi3, VGGT and MoGe normalise inside; Depth Anything 3 and MapAnything (which claims metres) want it done.
    norm = "imagenet" if (kind == "depth" and not vggt) or (kind == "pointmap" and claims) else "identity"
    written = {"pose_enc": "pose_enc9", "raw_poses": "raw9", "extrinsics": "w2c", "extrinsic": "w2c"}
    conf = "logit" if kind == "pointmap" and not claims else "exp1"
    return {
        "norm": ("half" if kind == "pair" else norm, "guessed"),
        "patch": (16 if kind == "pair" else 14, "guessed"),
        "fit": ("pad_white" if vggt else "resize", "guessed"),
        "fixed_hw": (fixed, "graph" if fixed else "default"),
        "max_views": ({"pair": 2, "mono": 1}.get(kind), "default"),
        "n_static": (static, "graph" if static else "default"),
        "pose": (written.get(pose, "c2w"), "guessed" if pose else "default"),
        "conf": (conf, "guessed") if "conf" in ports else ("none", "default"),
        # MapAnything's factor is in its points already, MoGe's is not.
        "scale": (("applied" if kind == "pointmap" else "factor"), "guessed") if claims else ("none", "default"),
    }


def _given(path: Path, metadata: Mapping[str, str]) -> dict[str, tuple[Any, str]]:
    """Key -> (value, origin) of what the file or its sidecar says."""
    out: dict[str, tuple[Any, str]] = {}
    beside = sidecar(path)
    sources: list[tuple[str, Mapping[str, Any]]] = []
    if beside.is_file():
        entries = read_json(beside)
        if not isinstance(entries, dict):
            raise ModelError("the model's sidecar is not an object", file=beside, expected='{"kind": ...}')
        sources.append(("sidecar", entries))
    sources.append(("metadata", metadata))
    for origin, values in sources:
        for key, text in values.items():
            if key in PARSERS and text is not None and text != "":
                out[key] = (PARSERS[key](path if origin == "metadata" else beside, key, text), origin)
    return out


def _choice(path: Path, key: str, text: Any) -> str:
    known = CHOICES.get(key, ADAPTERS)
    if str(text) not in known:
        what = "kind of model" if key == "kind" else f"value of {key}"
        raise UnknownNameError(what, str(text), list(known), file=path)
    return str(text)


def _count(path: Path, key: str, text: Any) -> int | None:
    if str(text).lower() in ("none", "null", "false"):
        return None
    if not re.fullmatch(r"[1-9]\d{0,5}", str(text)):
        raise ModelError(f"{key} is not a number", file=path, expected="a whole number above 0", found=str(text))
    return int(text)


def _size(path: Path, key: str, text: Any) -> tuple[int, int] | None:
    if str(text).lower() in ("none", "null", "false"):
        return None
    numbers = re.findall(r"\d+", str(text))
    if len(numbers) != 2 or not all(1 <= int(v) <= 8192 for v in numbers):
        raise ModelError(f"{key} is not a size", file=path, expected="height and width, as in 518,518", found=str(text))
    return int(numbers[0]), int(numbers[1])


PARSERS: dict[str, Callable[[Path, str, Any], Any]] = {
    **dict.fromkeys(("kind", *CHOICES), _choice),
    **dict.fromkeys(("patch", "max_views", "n_static"), _count),
    "fixed_hw": _size,
}
