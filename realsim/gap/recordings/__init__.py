"""Robot logs as people have them: any recording read, taken apart, and written as a case for `realsim diagnose`.

    from realsim.gap.recordings import load_target, propose, read, write_case
    proposal = propose(read("walk.mcap"), target := load_target("robot.xml"))
    print(proposal.render())
    write_case(proposal, target, "case")

readers/      one file per format            recording.py  what they all return
infer.py      which field is what          joints.py, commands.py, body.py  the evidence for it
clocks.py     one time for all streams     case.py       the folder of the contract
"""

from realsim.gap.recordings.case import write_case
from realsim.gap.recordings.infer import propose
from realsim.gap.recordings.model import Target, load_target
from realsim.gap.recordings.proposal import Proposal
from realsim.gap.recordings.readers import READERS
from realsim.gap.recordings.reading import read
from realsim.gap.recordings.recording import Recording, Window
from realsim.gap.recordings.world import World, load_world

__all__ = [
    "READERS", "Proposal", "Recording", "Target", "Window", "World", "load_target", "load_world", "propose", "read",
    "write_case",
]  # fmt: skip
