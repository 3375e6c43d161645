"""Was the policy run as it was trained? The policy replayed on what was logged, and a fit of what has to differ.

    from realsim.gap.checks.contract import check, load_policy, read_steps
    found = check(load_policy("policy.onnx"), read_steps(case))
    print(found.sentence)

policy.py    the contract                             formats.py    where contracts are written down
steps.py     what the policy saw and sent             loop.py       observations -> actions -> targets, as parameters
proposals.py what may differ, with its parameters     search.py     one score, a mistake after the other
servo.py     gains, by the measured torque            answer.py     rates, verdict, sentence
settings.py  the setting, in the framework's words
"""

from realsim.gap.checks.contract.answer import Found, check
from realsim.gap.checks.contract.formats import load_policy
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.steps import Steps, read_steps

__all__ = ["Contract", "Found", "Steps", "check", "load_policy", "read_steps"]
