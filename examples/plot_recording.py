"""What a policy's layers do over a clip or a gait: `plot_recording.py recording.h5 picture.png [LAYER]`.

It needs h5py, NumPy and Matplotlib. The file comes from `gaitway rollout JOB --record` and
`gaitway download last recording.h5` (docs/neuroscience.md).
"""

import argparse
from pathlib import Path

import h5py
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def principal_components(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows [T, n] along their two directions of most variance [T, 2], and each one's share of it all.

    The greatest number of a direction is positive, as in the picture on the job's page.
    """
    values = np.column_stack([values, np.zeros(len(values))])  # One number alone has no second direction.
    centred = values - values.mean(axis=0)
    _, deviations, directions = np.linalg.svd(centred, full_matrices=False)
    directions *= np.sign([[row[np.argmax(np.abs(row))]] for row in directions])
    return centred @ directions[:2].T, deviations[:2] ** 2 / max(np.sum(deviations**2), 1e-12)


def gait_phase(joints: np.ndarray, step_s: float) -> np.ndarray:
    """The phase [T] in [0, 1) of the joints' strongest rhythm of more than 0.5 Hz: joints [T, n]."""
    swing = principal_components(joints)[0][:, 0]
    spectrum, frequencies = np.fft.fft(swing - swing.mean()), np.fft.fftfreq(len(swing), step_s)
    strongest = frequencies[np.argmax(np.abs(spectrum) * (frequencies > 0.5))]
    near = (frequencies > 0.5 * strongest) & (frequencies < 1.5 * strongest)
    return np.angle(np.fft.ifft(np.where(near, spectrum, 0))) / (2 * np.pi) % 1


def phase_of(file: h5py.File, episode: h5py.Group) -> np.ndarray:
    """Of each action: how far its clip has come, or, without a clip, the phase of the gait."""
    if "clip_frame" in episode:
        frames, clips = episode["clip_frame"][:-1], episode["clip"][:-1]
        return frames / file["names/clip"].attrs["num_frames"][clips]
    units = episode["qpos"].dims[1]["units"].asstr()[:]
    return gait_phase(episode["qpos"][:-1, units == "rad"], file.attrs["step_s"])


def plot(recording: Path, picture: Path, layer: str | None = None) -> None:
    """Draw each step of all episodes in the plane of the layer's two first components."""
    with h5py.File(recording) as file:
        episodes = [file[f"episode_{number}"] for number in range(file.attrs["num_episodes"])]
        names: list[str] = []
        episodes[0]["activations"].visititems(
            lambda name, found: names.append(name) if isinstance(found, h5py.Dataset) else None
        )
        layer = layer or ("latent/mean" if "latent/mean" in names else names[0])
        if layer not in names:
            raise SystemExit(f"There is no layer {layer!r}; there are {', '.join(names)}.")
        values = np.concatenate([episode[f"activations/{layer}"] for episode in episodes])
        phases = np.concatenate([phase_of(file, episode) for episode in episodes])
        is_clip = "clip_frame" in episodes[0]
    points, shares = principal_components(values)
    figure, axes = plt.subplots(figsize=(6, 5), layout="constrained")
    colours = "viridis" if is_clip else "twilight"
    shown = axes.scatter(*points.T, c=phases, cmap=colours, s=6, vmin=0, vmax=1)
    figure.colorbar(shown, label="share of the clip" if is_clip else "phase of the gait")
    axes.set_title(f"{layer}: {len(values):,} steps of {len(episodes)} episodes")
    axes.set_xlabel(f"first component, {shares[0]:.0%} of the variance")
    axes.set_ylabel(f"second component, {shares[1]:.0%}")
    figure.savefig(picture, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("layer", nargs="?")
    plot(**vars(parser.parse_args()))
