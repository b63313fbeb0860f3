"""Checks of the theorems on thousands of maps."""
