"""The whole loop on the thesis's rig."""
