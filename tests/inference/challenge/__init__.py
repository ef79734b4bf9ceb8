"""The challenge: measurements with a hidden cause, and the score of whoever names it. See docs/criticism/challenge.md.

Nothing here imports the effects or the critic: what hides a cause must not share a line with what looks for it.
"""
