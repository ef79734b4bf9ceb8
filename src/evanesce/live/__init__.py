"""Live page: a rig with sliders. Only ``page``, ``layout``, ``widgets`` and ``server`` import the web framework."""
