"""Everything that takes long, in one command, and the README's line with its last result."""
