"""Where the gap lies and what it looks like, before any cause is fitted."""
