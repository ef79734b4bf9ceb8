"""Sliding: friction of the interface, partial slip with its history, programmes, torsion, stick-slip."""
