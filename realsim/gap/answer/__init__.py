"""What is said in the end: the verdict, how much is gone on unseen runs, the patch."""
