"""Base of every package: quantities with units, frozen states, errors, random streams, provenance."""
