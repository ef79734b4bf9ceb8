"""The only room that sees an estimate and the truth together."""
