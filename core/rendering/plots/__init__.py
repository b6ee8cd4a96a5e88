"""Plots. matplotlib (extra `plots`) is loaded only when one is drawn."""
