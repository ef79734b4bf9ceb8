"""The command line: each module parses, calls and prints; no physics and no image processing lives here."""

from evanesce.cli.app import main

__all__ = ["main"]
