"""Was the policy run as it was trained? The policy replayed on what was logged, under every way to get it wrong.

    from realsim.gap.checks.contract import check, load_policy, read_steps
    found = check(load_policy("policy.onnx"), read_steps("case"))
    print(found.sentence)

policy.py    the contract, from the ONNX file's metadata or deploy.yaml    steps.py   what the policy saw and sent
replay.py    observations -> actions -> targets, right or wrong            kinds.py   the ways to get it wrong
compare.py   which of them explains the targets that were sent
"""

from __future__ import annotations

from realsim.gap.checks.contract.compare import Found, check
from realsim.gap.checks.contract.policy import Contract, load_policy
from realsim.gap.checks.contract.steps import Steps, read_steps

__all__ = ["Contract", "Found", "Steps", "check", "load_policy", "read_steps"]
