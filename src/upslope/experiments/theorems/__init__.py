"""The theorems, on thousands of maps."""
