"""Starts the service that a bench measures, waits for it, and sends it requests."""
