"""What drives learners: compiled programs, or host environments with compiled updates."""
