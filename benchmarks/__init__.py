"""Timings, never asserted: each module is one command, prints a table and writes JSON."""
