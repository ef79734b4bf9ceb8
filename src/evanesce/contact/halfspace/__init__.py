"""Contact of an elastic half-space with rigid glass for any height map, with or without adhesion."""
