"""Benches of training, physics, rendering and memory, without a GPU (`memory --gpu` needs one)."""
