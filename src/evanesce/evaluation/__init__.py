"""Comparison of estimates with the truth; only this package and those above it see both."""
