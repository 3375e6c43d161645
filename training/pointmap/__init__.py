"""The pointmap network that ships: its scenes, its training, its evaluation and its export (README.md).

Scenes, network, loss and training need torch and numpy only, so that they run on a GPU machine as it comes. Evaluation
on captures and the export need the rest of realsim.
"""
