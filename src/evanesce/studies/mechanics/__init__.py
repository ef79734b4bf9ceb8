"""Areas, sliding and ridges from the thesis's inputs alone."""
