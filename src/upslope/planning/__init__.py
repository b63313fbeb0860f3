"""Exact planning in finite tasks, and what is measured against it."""
