"""The page that shows training runs: `realsim training report RUN ...`. It needs no torch to draw a history.

history.py      the folder of a run -> `Run`: columns, what they can be drawn over, evaluations
evaluations.py  trials in evaluation*.json and result.json -> `Evaluated`
curves.py       one plot over iterations, samples and training minutes
figures.py      which figures of the history belong together, and what they are called
endings.py      how episodes end, and where trials failed
tables.py       runs side by side, also after equally long training
replays.py      rendered trials (the one part that needs torch)
document.py     the page
"""

from trainer.report.document import training_page
from trainer.report.history import Run, read_runs

__all__ = ["Run", "read_runs", "training_page"]
