"""Processes that a bench starts: `python -m bench.children.NAME FOLDER` answers FOLDER/request.json."""
