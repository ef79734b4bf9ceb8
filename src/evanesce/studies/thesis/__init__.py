"""The thesis's experiments in simulation, figure by figure."""
