"""Area error against the threshold, and rules that set it."""
