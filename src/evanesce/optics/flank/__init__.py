"""Light that leaves the plate's top face beside the contact and falls on the finger's flank."""
