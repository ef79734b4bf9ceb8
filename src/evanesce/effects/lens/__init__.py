"""Effects of lens, shutter and what lies on the sensor."""
