"""Benches of the running service."""
