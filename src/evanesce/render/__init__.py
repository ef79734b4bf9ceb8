"""The only room that knows Mitsuba and Dr.Jit."""
