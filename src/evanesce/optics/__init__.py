"""Media, interface, LEDs and closed forms: pure functions, the oracle of the renderer."""
