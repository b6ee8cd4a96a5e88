"""Measurements against targets and peers: `./run bench [NAME ...]`. Each prints a table and writes JSON."""
