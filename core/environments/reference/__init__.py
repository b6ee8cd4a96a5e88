"""What a body follows: clips as frames, how episodes move along them, and where they begin."""
