"""A rollout's recording: what it stores is what the network's formula makes of the stored observations."""

import json
import os
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from core.algorithms.export.network import network_of
from core.algorithms.latent import LatentPoints, plotted_layer
from core.algorithms.ppo.spec import PPOSpec
from core.environments.trajectory import Episode, FollowedClip
from core.errors import JobFailed
from core.jobs.spec import JOB_SPEC, RolloutSpec
from tests.exports import policy_file
from worker.protocol import MESSAGE, FileReady, Task
from worker.training.built_environment import build_environment
from worker.training.event_writer import EventWriter
from worker.training.roll_out import roll_out

SETTINGS = PPOSpec.model_validate(
    {
        "network": {"kind": "intention", "latent": 2, "encoder": [5], "decoder": [6], "places": [[1, 2]]},
        "activation": "tanh",
        "normalize_observations_max_abs_value": 1.5,
    }
)
SEEN = np.random.default_rng(0).normal(0, 0.1, (50, 4)).astype(np.float32)
EXAMPLE = runpy.run_path(str(Path(__file__).parents[4] / "examples" / "plot_recording.py"))
POLICY = {"kind": "checkpoint", "job": "019aa3c2f0b1-5be0c1d2e3"}


def opened(path: Path) -> Any:
    """The file; h5py's types do not tell groups from datasets."""
    return h5py.File(path)


def rolled_out(folder: Path, **own: Any) -> FileReady:
    """The recording of two episodes of the pendulum."""
    document = {"kind": "rollout", "environment": "inverted_pendulum", "num_steps": 8, "num_episodes": 2}
    spec = JOB_SPEC.validate_python({"policy": POLICY, **document, "video": None, **own})
    assert isinstance(spec, RolloutSpec)
    (folder / "policy").write_bytes(policy_file(SETTINGS, SEEN, 1))
    task = Task(job_id="j", attempt=1, spec=spec, device="cpu", checkpoint="policy", policy_of="ppo")
    read, write = os.pipe()
    events = EventWriter(folder, write)
    never: Any = SimpleNamespace(asked=False)
    with os.fdopen(read, "rb") as pipe:
        try:
            roll_out(task, spec, build_environment(task), events, never)
        finally:
            events._pipe.close()
        said = [MESSAGE.validate_json(line) for line in pipe]
    [kept] = [one for one in said if isinstance(one, FileReady) and one.name == "recording.h5"]
    return kept


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FileReady]:
    """A recording of all layers."""
    folder = tmp_path_factory.mktemp("whole")
    kept = rolled_out(folder, recording=True, seed=3)
    return folder / kept.path, kept


def test_activations_are_the_formula_of_the_stored_observations(whole: tuple[Path, FileReady]) -> None:
    recording, kept = whole
    names = ["encoder/0", "latent/mean", "latent/std", "latent/sample", "decoder/0", "decoder/1"]
    assert (kept.name, kept.metadata) == ("recording.h5", {"episodes": 2, "layers": names})
    network = network_of(policy_file(SETTINGS, SEEN, 1))
    (first, last), (hidden, out) = (
        [(layer.kernel, layer.bias) for layer in layers] for layers in (network.encoder, network.layers)
    )
    with opened(recording) as file:
        assert (file.attrs["job"], file.attrs["seed"], file.attrs["activation"]) == ("j", 3, "tanh")
        assert file.attrs["step_s"] == pytest.approx(file["episode_1/time"][1])
        assert [*file["names/qpos"].asstr()] == ["qpos/slider", "qpos/hinge"]
        for number in range(2):
            episode = file[f"episode_{number}"]
            found = {name: episode["activations"][name][:] for name in names}
            seen = np.clip((episode["observation"][:-1] - network.mean) / network.std, -1.5, 1.5)
            encoded = np.tanh(seen[:, [1, 2]] @ first[0] + first[1])
            mean, log_std = np.split(encoded @ last[0] + last[1], 2, axis=1)
            decoded = np.tanh(np.concatenate([mean, seen[:, [0, 3]]], axis=1) @ hidden[0] + hidden[1])
            expected = [encoded, mean, np.exp(log_std), mean, decoded, decoded @ out[0] + out[1]]
            for name, values in zip(names, expected, strict=True):
                np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-5, err_msg=name)
            location = found["decoder/1"][:, :1]
            np.testing.assert_allclose(np.tanh(location), episode["action"], rtol=0, atol=1e-5)


def test_the_plane_of_the_intention_is_kept_beside_it(whole: tuple[Path, FileReady]) -> None:
    recording, _ = whole
    found = json.loads((recording.parent / "latent.json").read_bytes())
    with opened(recording) as file:
        mean = np.concatenate([file[f"episode_{number}/activations/latent/mean"] for number in (0, 1)])
        steps = [file[f"episode_{number}"].attrs["num_steps"] for number in (0, 1)]
    assert (found["layer"], found["size"], found["clips"]) == ("latent/mean", 2, [])
    assert found["episode"] == [0] * steps[0] + [1] * steps[1]
    # Two numbers have all of their variance in the plane; their covariance says how it is shared.
    variances = np.sort(np.linalg.eigvalsh(np.cov(mean.T)))[::-1]
    np.testing.assert_allclose(found["variance"], variances / variances.sum(), atol=1e-4)
    np.testing.assert_allclose(np.var([found["x"], found["y"]], axis=1, ddof=1), variances, rtol=0.01)
    points, _ = EXAMPLE["principal_components"](mean)
    np.testing.assert_allclose(np.transpose([found["x"], found["y"]]), points, atol=1e-4)


def test_a_perceptron_is_looked_at_by_its_last_hidden_layer() -> None:
    layers = ["policy/0", "policy/1", "policy/2"]
    assert plotted_layer(layers, layers) == "policy/1"
    assert plotted_layer(["policy/0", "policy/2"], layers) is None
    assert plotted_layer([], []) is None


def test_many_steps_become_few_points_that_know_their_clip() -> None:
    clips = [FollowedClip("a", 0, 3000), FollowedClip("b", 3000, 2000)]
    times = np.arange(5001) * 0.02
    names = ("qpos", "qvel", "position", "observation", "action", "reward")
    arrays: dict[str, Any] = dict.fromkeys(names, np.zeros(5000))
    arrays |= {"time": times, "reference_frame": np.arange(5001)}
    episode = Episode(terminated=False, **arrays)
    points = LatentPoints("latent/mean", 5000, clips)
    points.add(episode, np.stack([times[:-1], 0 * times[:-1]], axis=1).astype(np.float32))
    found = points.document()
    assert found is not None
    # Every third step. All variance is in time, whose mean is 49.99 s.
    assert (len(found["x"]), found["variance"]) == (1667, [1.0, 0.0])
    assert (found["x"][0], found["y"][0]) == (pytest.approx(-49.99, abs=0.03), 0.0)
    # Frames 2,499 and 3,999: of the first clip 0.833 are over, and of the second 0.4995.
    assert [found[name][833] for name in ("clip", "share")] == [0, 0.833]
    assert [found[name][1333] for name in ("clip", "share")] == [1, 0.5]


def test_the_example_draws_a_layer(whole: tuple[Path, FileReady], tmp_path: Path) -> None:
    recording, _ = whole
    EXAMPLE["plot"](recording, tmp_path / "encoder.png", "encoder/0")
    assert (tmp_path / "encoder.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(SystemExit, match="no layer 'policy/0'; there are decoder/0, decoder/1, encoder/0, "):
        EXAMPLE["plot"](recording, tmp_path / "none.png", "policy/0")
    # A rhythm of 2 Hz, of which both joints have a part: a turn takes half a second.
    seconds = np.arange(400) * 0.01
    joints = np.stack([np.sin(4 * np.pi * seconds), np.cos(4 * np.pi * seconds - 1)], axis=1)
    phase = EXAMPLE["gait_phase"](joints, 0.01)
    np.testing.assert_allclose(np.diff(np.unwrap(phase, period=1)), 0.02, atol=1e-6)


def test_a_policy_without_layers_has_a_recording_without_activations(tmp_path: Path) -> None:
    kept = rolled_out(tmp_path, policy={"kind": "random"}, recording={})
    assert kept.metadata["layers"] == []
    with opened(tmp_path / "recording.h5") as file:
        assert "activations" not in file["episode_0"]
        assert file["episode_0/body_position"].shape[1:] == (2, 3)


def test_a_layer_that_is_not_there_is_refused_before_anything_is_done(tmp_path: Path) -> None:
    with pytest.raises(JobFailed, match=r"No layer of the policy is called 'policy/0'\. It has encoder/0, "):
        rolled_out(tmp_path, recording={"layers": ["policy/0"]})
    assert not list(tmp_path.glob("*.h5"))
