"""Whether stated intervals of an area hold the truth."""
