"""The bytes between suite and testee: the link, and what is due on it."""
