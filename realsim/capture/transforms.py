"""A tree of frames (tf): from transforms, fixed and moving, to the pose of one frame at a time."""

from dataclasses import dataclass, field

import numpy as np

from realsim.capture.association import interpolate_poses
from realsim.core.errors import CaptureError
from realsim.core.geometry import make_T, quat_to_R
from realsim.core.types import F64

MAX_DEPTH = 64


@dataclass
class Tree:
    """Who hangs on whom. `T_parent_child` maps points of the child into the parent."""

    parents: dict[str, str] = field(default_factory=dict)
    fixed: dict[str, F64] = field(default_factory=dict)
    """Child -> (4, 4)."""
    moving: dict[str, tuple[list[float], list[F64]]] = field(default_factory=dict)
    """Child -> (times s, (4, 4) each)."""
    doubts: dict[str, None] = field(default_factory=dict)
    """What was odd, each once."""

    def add(self, parent: str, child: str, T: F64, time: float, *, static: bool) -> None:
        """One transform; a child that had another parent keeps the first."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if not np.isfinite(T).all() or parent == child or not child:
            self.doubts[f"a transform to {child!r} is no transform"] = None
            return
        if self.parents.setdefault(child, parent) != parent:
            self.doubts[f"{child} hangs on {self.parents[child]} and on {parent}: the first is used"] = None
            return
        if static:
            self.fixed[child] = T
        else:
            times, poses = self.moving.setdefault(child, ([], []))
            times.append(time)
            poses.append(T)

    def chain(self, frame: str) -> list[str]:
        """From a frame up to (not including) the root."""
        links, at = [], frame.lstrip("/")
        while at in self.parents:
            links.append(at)
            at = self.parents[at]
            if len(links) > MAX_DEPTH or at in links:
                raise CaptureError("the frames of tf go round in a circle", found=" -> ".join([*links[:6], at]))
        return links

    def root(self, frame: str) -> str:
        """The frame that everything above hangs on."""
        chain = self.chain(frame)
        return self.parents[chain[-1]] if chain else frame

    def moves(self, frame: str) -> bool:
        """Whether a transform above the frame changes with time."""
        return any(child in self.moving for child in self.chain(frame))

    def poses(self, frame: str, times: F64, max_gap: float) -> list[F64 | None]:
        """`T_root_frame` (4, 4) at each time, or None where a moving link has no samples near enough."""
        result: list[F64 | None] = [np.eye(4) for _ in times]
        for child in self.chain(frame):
            if child in self.moving:
                stamps, poses = (np.array(v) for v in self.moving[child])
                order = np.unique(stamps, return_index=True)[1]
                links = interpolate_poses(stamps[order], poses[order], times, max_gap)
            else:
                links = [self.fixed[child]] * len(times)
            result = [None if a is None or b is None else b @ a for a, b in zip(result, links, strict=True)]
        return result

    def between(self, target: str, source: str) -> F64 | None:
        """`T_target_source` where only fixed links lie between them, else None."""
        up, down = self.chain(target.lstrip("/")), self.chain(source.lstrip("/"))
        while up and down and up[-1] == down[-1]:
            up.pop(), down.pop()
        if self.root(target) != self.root(source) or not all(c in self.fixed for c in [*up, *down]):
            return None
        T_target, T_source = np.eye(4), np.eye(4)
        for child in up:
            T_target = self.fixed[child] @ T_target
        for child in down:
            T_source = self.fixed[child] @ T_source
        return np.asarray(np.linalg.inv(T_target) @ T_source)


def matrix(translation: object, rotation: object) -> F64:
    """(4, 4) of a ROS translation and quaternion; NaN where the quaternion is none."""
    q = np.array([getattr(rotation, a) for a in "wxyz"], float)
    t = np.array([getattr(translation, a) for a in "xyz"], float)
    if not 0.5 < np.linalg.norm(q) < 1.5:
        return np.full((4, 4), np.nan)
    return make_T(quat_to_R(q), t)
