"""Train the pointmap network.

    python -m training.pointmap.train --out run --minutes 9
    torchrun --standalone --nproc-per-node 2 -m training.pointmap.train --out run --minutes 9

The folder `run` gets the state (`--resume run` goes on from it) and `curve.jsonl`, a row every `--log-every` steps.
Needs torch and numpy only.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

from realsim.core.errors import RealsimError
from training.pointmap import loss, shipped, state
from training.pointmap.draw import Draw
from training.pointmap.layouts import library
from training.pointmap.network import PATCH, SHAPES, PointmapNet, count
from training.pointmap.scenes import MAX_REUSE, Batch, Generator

TRAINING, WITHHELD = 1, 900
"""Seeds of what is trained on (plus the rank) and of what is evaluated on: no layout is in both."""
UNCALIBRATED = 0.1
"""Share of scenes whose intrinsics are left out."""
COMPILED = ("none", "rays", "all")
GIVE_UP = 25
"""Steps in a row without finite gradients after which training stops."""


@dataclass
class Options:
    """Of a run."""

    out: Path = Path("run")
    resume: Path | None = None
    shape: str = "full"
    height: int = 240
    width: int = 320
    images: int = 96
    """Pictures a step and process."""
    views: tuple[int, ...] = (2, 4, 6, 8)
    """Views of a scene: one of these a step."""
    samples: int = 2
    """Rays a pixel."""
    reuse: int = 2
    """Steps on every rendered scene, each with other exposure, noise and sensor."""
    scenes: int = 4096
    """Layouts in the library."""
    minutes: float = 9.0
    """Wall-clock time of this run."""
    steps: int = 0
    """Stop after so many steps of this run; 0: only time counts."""
    cooldown: float = 0.0
    """Minutes at the end of this run in which the learning rate sinks to zero."""
    lr: float = 4e-4
    warmup: int = 500
    """Steps, also after a resume without moments."""
    decay: float = 0.05
    log_every: int = 20
    save_every: float = 2.0
    """Minutes."""
    device: str = "auto"
    compile: str = "none"
    """What torch.compile fuses: `rays` of the generator, `all` the network too; a minute or more at first."""
    seed: int = 0

    def check(self) -> None:
        """Refuse what cannot be trained."""
        if self.height % PATCH or self.width % PATCH or min(self.height, self.width) < 2 * PATCH:
            raise RealsimError(
                "pictures of that size cannot be cut into patches", expected=f"multiples of {PATCH}, 32 or more",
                found=f"{self.height} x {self.width}",
            )  # fmt: skip
        if min(self.views) < 1 or self.images < max(self.views):
            raise RealsimError(
                "a step holds no scene", expected="--images of at least the most --views", found=f"{self.images}"
            )
        for name in ("samples", "reuse", "scenes", "log_every"):
            if getattr(self, name) < 1:
                raise RealsimError(f"--{name.replace('_', '-')} must be 1 or more", found=str(getattr(self, name)))
        if self.reuse > MAX_REUSE:
            raise RealsimError("--reuse is too large", expected=f"at most {MAX_REUSE}", found=str(self.reuse))
        if self.shape not in SHAPES:
            raise RealsimError("no such network", expected=", ".join(SHAPES), found=self.shape)
        if self.compile not in COMPILED:
            raise RealsimError("no such choice of --compile", expected=", ".join(COMPILED), found=self.compile)


@dataclass(frozen=True)
class Rank:
    """Which of several processes this is."""

    index: int
    count: int
    device: torch.device


@contextmanager
def ranks(device: str) -> Iterator[Rank]:
    """This process's rank, with the group open if torchrun started more than one."""
    index, many = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    name = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    if name == "cuda" and not torch.cuda.is_available():
        raise RealsimError("there is no CUDA device", hint="--device cpu")
    local = torch.device(name, int(os.environ.get("LOCAL_RANK", "0"))) if name == "cuda" else torch.device(name)
    if many == 1:
        yield Rank(0, 1, local)
        return
    if local.type == "cuda":
        torch.cuda.set_device(local)
    dist.init_process_group("nccl" if local.type == "cuda" else "gloo")
    try:
        yield Rank(index, many, local)
    finally:
        dist.destroy_process_group()


def main() -> None:
    """The command line."""
    try:
        options = parse(sys.argv[1:])
        with ranks(options.device) as rank:
            train(options, rank)
    except RealsimError as error:
        print(error.render(), file=sys.stderr)
        sys.exit(2)


def parse(arguments: list[str]) -> Options:
    """Options of a command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for f in fields(Options):
        name, default = f"--{f.name.replace('_', '-')}", f.default
        if isinstance(default, tuple):
            parser.add_argument(name, type=int, nargs="+", default=list(default))
        else:
            kind = Path if f.name in ("out", "resume") else type(default)
            parser.add_argument(name, type=kind, default=default, help=f"default {default}")
    found = vars(parser.parse_args(arguments))
    return Options(**{**found, "views": tuple(found["views"])})


def train(o: Options, rank: Rank) -> state.State:
    """Train until the time or the steps are over; the state is in `o.out`.

    Raises:
        RealsimError: options that make no sense, a state that cannot be read, gradients that stay infinite.
    """
    o.check()
    begun = time.monotonic()
    torch.manual_seed(o.seed)
    now = _begin(o)
    now.net.to(rank.device)
    optimiser = torch.optim.AdamW(_groups(now.net, o.decay), lr=o.lr, betas=(0.9, 0.98))
    warm = now.step if o.resume and state.restore(now, optimiser) else now.step + o.warmup
    run: Any = torch.compile(now.net) if o.compile == "all" else now.net
    made = Generator(
        library(o.scenes, TRAINING + o.seed * 1000 + rank.index * 17), TRAINING + o.seed, rank.device,
        samples=o.samples, compiled=o.compile != "none",
    )  # fmt: skip
    log = _Log(o.out / "curve.jsonl" if rank.index == 0 else None, o.log_every)
    if rank.index == 0:
        print(
            f"{count(now.net) / 1e6:.1f} M parameters, {rank.count} x {rank.device}, from step {now.step}", flush=True
        )
    first, before, saved, failed, over, spent = now.step, now.minutes, begun, 0, False, 0.0
    while not over:
        render, again = divmod(now.step, o.reuse)
        views = o.views[int(Draw.of(o.seed, render, "cpu").below(len(o.views), 1))]
        index = render * rank.count + rank.index
        clock = time.monotonic()
        if again == 0 or now.step == first:
            rendered = made.render(index, o.images // views, views, (o.height, o.width))
        batch = made.observe(rendered, index, again)
        clock = _since(clock, rank.device)
        rate = o.lr * min(1.0, (now.step + 1 - first) / o.warmup if warm > first else 1.0)
        if o.cooldown:
            rate *= min(1.0, max(o.minutes - spent, 0) / o.cooldown)
        for group in optimiser.param_groups:
            group["lr"] = rate
        parts = _step(run, batch, Draw.of(o.seed + 5, now.step * rank.count + rank.index, rank.device))
        norm, spent = _gather(now.net, (time.monotonic() - begun) / 60, rank)
        over = spent >= o.minutes or 0 < o.steps <= now.step + 1 - first
        failed = 0 if norm < float("inf") else failed + 1
        if failed >= GIVE_UP:
            raise RealsimError(
                "training diverged", found=f"{failed} steps without finite gradients", hint="a lower --lr"
            )
        if not failed:
            optimiser.step()
        now.step, now.views = now.step + 1, now.views + batch.depth.shape[0] * views * rank.count
        now.minutes = before + spent
        log.add(now, rate, {**parts, "gradient": norm}, clock, over)
        if rank.index == 0 and (over or time.monotonic() - saved > 60 * o.save_every):
            state.save(o.out, now, optimiser)
            saved = time.monotonic()
    return now


def _begin(o: Options) -> state.State:
    if o.resume is None:
        return state.State(PointmapNet(SHAPES[o.shape]))
    return shipped.any_of(o.resume)


def _groups(net: PointmapNet, decay: float) -> list[dict]:
    """Weight matrices shrink, everything else does not."""
    flat = [p for p in net.parameters() if p.ndim < 2]
    return [{"params": [p for p in net.parameters() if p.ndim >= 2], "weight_decay": decay},
            {"params": flat, "weight_decay": 0.0}]  # fmt: skip


def _step(run: Any, batch: Batch, draw: Draw) -> dict[str, Tensor]:
    """Gradients of one batch, and the terms of its loss, those of scenes with and without depth apart."""
    device = batch.depth.device
    K = torch.where(draw.chance(UNCALIBRATED, len(batch.K), 1, 1, 1), 0.0, batch.K)
    for p in run.parameters():
        p.grad = None
    with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
        out = run(batch.images, batch.sensor, K, adjusted=False)
    parts = loss.terms(out, batch)
    value = loss.total(parts)
    value.backward()
    return {"loss": value.detach(), **{k: v.detach() for k, v in parts.items()}, **_split(out, batch)}


@torch.no_grad()
def _split(out: loss.Prediction, batch: Batch) -> dict[str, Tensor]:
    """Relative error of depth after median scaling, of scenes without and with sensor depth."""
    valid = (batch.depth > 0.05) & (batch.depth < loss.FAR)
    truth = batch.depth.clamp(min=0.05).log()
    off = out.log_z + loss.scene_shift(out.log_z, truth, valid)[:, None, None, None] - truth
    error = ((off.clamp(-3, 3).exp() - 1).abs() * valid).sum((1, 2, 3)) / valid.sum((1, 2, 3)).clamp(min=1)
    seeing = (batch.sensor > 0).flatten(1).any(1)
    return {"rgb": _mean(error[~seeing]), "rgbd": _mean(error[seeing])}


def _mean(values: Tensor) -> Tensor:
    return values.mean() if len(values) else values.new_tensor(float("nan"))


def _gather(net: PointmapNet, minutes: float, rank: Rank) -> tuple[float, float]:
    """Mean gradients over all processes, clipped; their norm, and the mean of the processes' clocks: what depends on
    time has to be the same everywhere."""
    grads = [p.grad for p in net.parameters() if p.grad is not None]
    if rank.count > 1:
        flat = torch.cat([*(g.flatten() for g in grads), grads[0].new_tensor([minutes])])
        dist.all_reduce(flat)
        minutes = float(flat[-1]) / rank.count
        at = 0
        for g in grads:
            g.copy_((flat[at : at + g.numel()] / rank.count).reshape(g.shape))
            at += g.numel()
    norm = float(torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0))
    return (norm if norm < float("inf") else float("inf")), minutes


def _since(clock: float, device: torch.device) -> float:
    """Milliseconds; waits for the GPU, which works ahead."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return 1e3 * (time.monotonic() - clock)


class _Log:
    """Means of every few steps, a JSON line each."""

    def __init__(self, path: Path | None, every: int) -> None:
        self.path, self.every = path, every
        self.kept: list[dict[str, Tensor | float]] = []
        self.clock = time.monotonic()

    def add(self, now: state.State, rate: float, parts: dict[str, Tensor | float], made_ms: float, last: bool) -> None:
        if self.path is None:
            return
        self.kept.append({**parts, "made_ms": made_ms})
        if len(self.kept) < self.every and not last:
            return
        row: dict[str, float] = {"step": now.step, "views": now.views, "minutes": round(now.minutes, 3), "lr": rate}
        for key in self.kept[0]:
            values = [float(k[key]) for k in self.kept]
            good = [v for v in values if v == v and abs(v) < float("inf")]
            row[key] = round(sum(good) / len(good), 5) if good else None  # type: ignore[assignment]
        row["step_ms"] = round(1e3 * (time.monotonic() - self.clock) / len(self.kept), 1)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print("  ".join(f"{k} {v:g}" if v is not None else f"{k} -" for k, v in row.items()), flush=True)
        self.kept, self.clock = [], time.monotonic()


if __name__ == "__main__":
    main()
