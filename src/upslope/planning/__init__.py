"""Exact planning in finite tasks, and measures of learned values against it."""
