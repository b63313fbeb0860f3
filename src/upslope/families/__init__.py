"""Families to study, and to copy: each file makes one family of tasks from a simulator that others wrote."""
