"""Options that verbs share, what they read at a terminal, and what they print."""
