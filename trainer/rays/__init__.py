"""Ray casters. One file a caster, one line in `CASTERS`."""

from trainer.rays.base import CASTERS, RayCaster, fall

__all__ = ["CASTERS", "RayCaster", "fall"]
