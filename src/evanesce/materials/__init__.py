"""Silicone tables and bench tests of a lab's files."""
