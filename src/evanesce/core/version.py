"""The version, below every layer: what imports the package itself would reach the public API above it."""

__version__ = "0.2.0"
