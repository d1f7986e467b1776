"""The bytes between suite and testee: the link, and the frames expected on it."""
