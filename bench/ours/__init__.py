"""Single runs of this project's code, each in a process of its own: `python -m bench.ours.X FOLDER`."""
