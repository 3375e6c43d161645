"""The answer: the verdict, how much is gone on unseen runs, the patch."""
