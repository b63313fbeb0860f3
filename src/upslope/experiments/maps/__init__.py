"""Experiments on grid games: Figures 2 to 5, and studies of their settings."""
