"""Data parallelism under torchrun: every rank has worlds of its own, gradients are averaged.

Everything here is a no-op without a process group, so that the algorithm reads the same on one chip and on many.
"""

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from trainer.errors import TrainerError

CPU_ENGINES = ("mujoco",)
"""Physics engines whose state lies on the CPU: the networks must be there too."""


@dataclass(frozen=True)
class Rank:
    """Which of the processes this is, and the device that it uses."""

    index: int
    count: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this rank writes files and shows progress."""
        return self.index == 0


@contextmanager
def ranks(device: str, engine: str = "") -> Iterator[Rank]:
    """This process's rank, with the process group open if torchrun started more than one.

    Args:
        device: "cpu" (gloo), "cuda" (nccl, one device a local rank), or "auto": CUDA where there is one.
        engine: the physics engine that will run; see `pick_device`.
    """
    index, count = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    chosen = pick_device(device, int(os.environ.get("LOCAL_RANK", "0")) if count > 1 else None, engine)
    if count == 1:
        yield Rank(0, 1, chosen)
        return
    if chosen.type == "cuda":
        torch.cuda.set_device(chosen)
    dist.init_process_group("nccl" if chosen.type == "cuda" else "gloo")
    try:
        yield Rank(index, count, chosen)
    finally:
        dist.destroy_process_group()


def pick_device(device: str, local: int | None = None, engine: str = "") -> torch.device:
    """The torch device of that name; a missing CUDA device is an error, never silently replaced.

    Args:
        device: "cpu", "cuda", "cuda:1", or "auto".
        local: which of the processes on this machine this is; None for the only one.
        engine: the physics engine that will run; "auto" is "cpu" for one whose state lies on the CPU.

    Raises:
        TrainerError: no such device, or one that the engine does not work with.
    """
    there = torch.cuda.is_available()
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", device):
        raise TrainerError("there is no such device", expected="cpu, cuda, cuda:N or auto", found=f"--device {device}")
    if device == "auto":
        device = "cuda" if there and engine not in CPU_ENGINES else "cpu"
    if device.startswith("cuda") and engine in CPU_ENGINES:
        raise TrainerError(
            f"the engine {engine} runs on the CPU",
            expected="--device cpu, or --engine warp",
            found=f"--device {device}",
            hint="leave --device out: it follows the engine",
        )
    if device.startswith("cuda") and not there:
        raise TrainerError(
            "no CUDA device",
            expected="a GPU that torch can use",
            found=f"torch {torch.__version__} without CUDA devices",
            hint="--device cpu (and --engine mujoco) runs on the processor, with far fewer worlds",
        )
    if device == "cuda" and local is not None:
        if local >= torch.cuda.device_count():
            raise TrainerError(
                "more local ranks than GPUs",
                found=f"local rank {local} of {torch.cuda.device_count()} GPUs",
                hint="torchrun --nproc-per-node at most the number of GPUs",
            )
        return torch.device("cuda", local)
    return torch.device(device)


def active() -> bool:
    """Whether there is more than this process."""
    return dist.is_available() and dist.is_initialized() and dist.get_world_size() > 1


def all_sum(x: Tensor) -> Tensor:
    """The sum of `x` over all ranks (`x` itself when alone)."""
    if active():
        x = x.clone()
        dist.all_reduce(x)
    return x


def all_mean(x: Tensor) -> Tensor:
    """The mean of `x` over all ranks."""
    return all_sum(x) / dist.get_world_size() if active() else x


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Replace gradients by their mean over ranks: one flat all-reduce, not one a tensor."""
    if not active():
        return
    gradients = [p.grad for p in parameters if p.grad is not None]
    flat = all_mean(torch.cat([g.flatten() for g in gradients]))
    for gradient, mean in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(mean.view_as(gradient))


def broadcast(*modules: nn.Module | None) -> None:
    """Give all ranks the first rank's parameters and buffers."""
    if not active():
        return
    for module in modules:
        for tensor in module.state_dict().values() if module is not None else ():
            dist.broadcast(tensor, src=0)


def gather(value: Any) -> list[Any]:
    """Every rank's value, in order, on every rank (values come from our own processes)."""
    if not active():
        return [value]
    values: list[Any] = [None] * dist.get_world_size()
    dist.all_gather_object(values, value)
    return values


def any_rank(flag: bool, device: torch.device) -> bool:
    """Whether the flag is set on any rank."""
    return bool(all_sum(torch.tensor(float(flag), device=device)).item()) if active() else flag
