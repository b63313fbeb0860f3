"""Environments on the host: where they run, and how they are stepped. Loads no JAX."""
