"""Clips: recordings of a body's motion, for imitation; their files, their checks and their changes."""
