"""The process that computes. It knows JAX and MuJoCo, and neither Redis nor the object store."""
