"""Force to pressure, gap and slip: analytic laws, half-space, finite elements, sliding; each gives a ContactState."""
