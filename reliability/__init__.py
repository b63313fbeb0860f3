"""Checks that runs survive what can happen to them: kills, signals, damaged files, full disks, races."""
