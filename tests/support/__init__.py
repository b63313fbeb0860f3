"""What several test files share; nothing here is itself a test."""
