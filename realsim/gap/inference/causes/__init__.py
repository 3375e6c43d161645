"""Which causes: every effect screened, the best refitted, rivals held against each other."""
