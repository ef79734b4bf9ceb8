"""Frames, images and time stamps read from files."""
