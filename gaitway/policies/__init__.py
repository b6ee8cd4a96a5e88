"""Trained policies as functions, read from their files without the service's code.

Each module has `load(content, is_checkpoint, deterministic)`, which gives the policy's parameters and
`answer(parameters, observation, key)`, to be jitted. `core.algorithms` writes the files, and the tests hold
both to the same answers. Needs JAX and msgpack (extra `policy`).
"""
