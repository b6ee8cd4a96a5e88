"""Reads the memory of an accelerator that this process has used."""


def peak_bytes() -> int | None:
    """The most bytes in use at once on the first device; None if the device does not count them."""
    import jax

    counted = jax.devices()[0].memory_stats()
    return counted.get("peak_bytes_in_use") if counted else None
