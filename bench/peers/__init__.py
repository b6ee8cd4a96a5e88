"""Single runs of other projects' code, or of what they publish, each in a process of its own."""
