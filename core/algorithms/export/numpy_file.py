"""Writes `policy.npz`, which `gaitway.exported_policy` reads with NumPy alone."""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from core.algorithms.export.contract import as_text
from core.algorithms.export.network import PolicyNetwork


def numpy_file(network: PolicyNetwork, about: Mapping[str, Any]) -> bytes:
    """The whole network and its contract, `about`, which is JSON text. Equal ones give equal bytes."""
    arrays: dict[str, Any] = {
        "about": np.array(as_text(about)),
        "observation_mean": network.mean,
        "observation_std": network.std,
    }
    for prefix, layers in (("", network.layers), ("encoder_", network.encoder)):
        for number, layer in enumerate(layers):
            arrays |= {f"{prefix}kernel_{number}": layer.kernel, f"{prefix}bias_{number}": layer.bias}
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()
