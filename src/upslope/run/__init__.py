"""The one loop, and all that knows of files, clocks and terminals."""
