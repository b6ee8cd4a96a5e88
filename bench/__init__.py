"""Five benches: physics, train, service, recovery, demo. `./run bench NAME` measures and keeps a summary."""
