"""Errors of training that tell a person what to do."""

from realsim.core.errors import RealsimError


class TrainerError(RealsimError):
    """A scene, policy, checkpoint or machine that training cannot work with."""

    usual_hint = "docs/training.md says what training needs; realsim help finetune lists its options"
