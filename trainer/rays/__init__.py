"""Ray casters. One file a caster, one line in `CASTERS`."""

from trainer.rays.base import CASTERS, RayCaster, caster

__all__ = ["CASTERS", "RayCaster", "caster"]
