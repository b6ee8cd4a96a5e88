"""Benches of training and physics on a GPU; the bench `gpu_ant` is `bench/gpu/ant.py`."""
