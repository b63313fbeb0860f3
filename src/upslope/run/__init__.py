"""The one loop; the only room that knows about files, clocks and terminals."""
