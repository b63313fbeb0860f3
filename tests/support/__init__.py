"""Helpers shared by several test files; contains no tests."""
