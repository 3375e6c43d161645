"""Errors of training that tell a person what to do."""

from realsim.core.errors import RealsimError


class TrainerError(RealsimError):
    """A scene, policy, checkpoint or machine that training cannot work with."""
