"""Helpers of the tests: small rigs, drawn boards, stand-in producers, decks of other programs."""
