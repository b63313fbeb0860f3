"""Environments of our own: stateless and compiled, with the signature of gymnax ≥ 1.0, and their Gymnasium twins."""
