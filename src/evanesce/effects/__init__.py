"""Departures from the ideal rig, one file each, found by walking this folder."""
