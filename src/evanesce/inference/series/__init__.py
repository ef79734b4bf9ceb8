"""Scalar series, alone or beside frames, as data of the critic."""
