"""A lab's bench files reduced: stiffness, DMA, friction, surface profiles."""
