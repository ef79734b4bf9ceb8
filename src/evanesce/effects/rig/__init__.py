"""Effects that change the rig itself: plate, LEDs, printed targets."""
