"""What every package rests on: quantities with units, frozen states, errors, random streams, provenance."""
