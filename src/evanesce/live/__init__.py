"""The live page: a rig with sliders. Everything but :mod:`page` and :mod:`server` is free of the web framework."""
