"""What clock, exposure and rows read one by one do to areas and to the onset of slip."""
