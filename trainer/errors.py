"""What can go wrong in training, said so that a person can act on it."""

from realsim.errors import RealsimError


class TrainerError(RealsimError):
    """A scene, policy, checkpoint or machine that training cannot work with."""
