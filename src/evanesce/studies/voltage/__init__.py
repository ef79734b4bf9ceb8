"""Area against LED voltage, and what is unpublished about it."""
