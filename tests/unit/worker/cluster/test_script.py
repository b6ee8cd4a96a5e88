"""The batch script, and the options of which it is made."""

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from core.errors import Misconfigured
from core.jobs.slots import CPU, SlotKind
from worker.cluster.checks import NodeGroup, what_is_wrong
from worker.cluster.options import SlurmOptions, Tunnel, read_options, seconds_of
from worker.cluster.script import Place, script_of

PLACE = Place(Path("/lab/me/cluster/settings"), Path("/lab/me/cluster/logs"), "gaitway worker")
WHOLE = """
max = 16
idle = 60.0
modules = ["cuda/12.4", "apptainer"]
setup = '''
source /etc/profile
'''
environment = {XDG_CACHE_HOME = "/scratch/me it's"}

[gpu]
partition = "gpu"
account = "vnl"
qos = "long"
time = "8:00:00"
cpus = 6
mem = "20G"
gpus = [1, 4]
gres = "gpu:a100:{gpus}"
options = ["--nice=100"]

[container]
kind = "apptainer"
image = "/images/gaitway worker.sif"

[tunnel]
host = "login1"
user = "me"
key = "/lab/me/.ssh/gaitway"
known_hosts = "/lab/me/.ssh/known_hosts"
"""


def options(**said: Any) -> SlurmOptions:
    return read_options(None, {"cpu": {}, **said})


def is_bash(script: str) -> bool:
    return subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


def test_a_script_of_defaults_asks_for_little() -> None:
    script = script_of(CPU, "gaitway-1-cpu-2", options(), PLACE)
    assert [line for line in script.splitlines() if line.startswith(("#!", "#SBATCH"))] == [
        "#!/bin/bash",
        "#SBATCH --job-name=gaitway-1-cpu-2",
        "#SBATCH --nodes=1",
        "#SBATCH --ntasks-per-node=1",
        "#SBATCH --cpus-per-task=8",
        "#SBATCH --mem=16G",
        "#SBATCH --output=/lab/me/cluster/logs/%j.log",
        "#SBATCH --open-mode=append",
        "#SBATCH --signal=B:TERM@55",
        "#SBATCH --requeue",
    ]
    assert is_bash(script)
    assert "export GAITWAY_DEVICE=cpu\n" in script
    assert "\ngaitway worker &\n" in script


def test_everything_that_the_file_says_is_in_the_script(tmp_path: Path) -> None:
    file = tmp_path / "slurm.toml"
    file.write_text(WHOLE)
    place = Place(
        PLACE.settings,
        PLACE.logs,
        PLACE.command,
        ("@FOLDER@/.s.PGSQL.5432:/d/.s.PGSQL.5432", "127.0.0.1:@PORT0@:127.0.0.1:8333"),
        1,
    )
    found = read_options(file, {"gpu": {"time": "1-00:00:00"}})
    script = script_of(SlotKind("gpu", 4), "g", found, place, ["n7", "n9"])
    for line in (
        "#SBATCH --partition=gpu",
        "#SBATCH --account=vnl",
        "#SBATCH --qos=long",
        "#SBATCH --time=1-00:00:00",
        "#SBATCH --cpus-per-task=24",
        "#SBATCH --mem=80G",
        "#SBATCH --gres=gpu:a100:4",
        "#SBATCH --exclude=n7,n9",
        "#SBATCH --nice=100",
        "module load cuda/12.4",
        "module load apptainer",
        "source /etc/profile",
        "export XDG_CACHE_HOME='/scratch/me it'\"'\"'s'",
        'export GAITWAY_DEVICE="gpu:${CUDA_VISIBLE_DEVICES:-0}"',
        'apptainer exec --nv --bind "$data" --bind "$sockets" \'/images/gaitway worker.sif\' '
        "python -m worker.main &",
    ):
        assert line in script.splitlines()
    assert '-L "$sockets/.s.PGSQL.5432:/d/.s.PGSQL.5432" -L "127.0.0.1:${ports[0]}:127.0.0.1:8333"' in script
    assert "-i /lab/me/.ssh/gaitway -o IdentitiesOnly=yes" in script
    assert is_bash(script)


def test_the_options_of_the_page_are_some(tmp_path: Path) -> None:
    page = (Path(__file__).parents[4] / "docs/clusters.md").read_text()
    (tmp_path / "slurm.toml").write_text("\n".join(re.findall(r"```toml\n(.*?)```", page, re.DOTALL)))
    found = read_options(tmp_path / "slurm.toml", {})
    assert {(kind.gpus, kind.hosts) for kind in found.kinds} == {(0, 1), (1, 1), (4, 1), (1, 2), (4, 2)}
    assert isinstance(found.tunnel, Tunnel)


def test_a_gang_asks_for_its_hosts_and_starts_the_script_on_each_of_them() -> None:
    found = options(gpu={"gpus": [4], "hosts": [1, 2], "cpus": 6, "mem": "20G"})
    assert found.kinds == (CPU, SlotKind("gpu", 4), SlotKind("gpu", 4, 2))
    script = script_of(SlotKind("gpu", 4, 2), "g", found, PLACE)
    for line in ("--nodes=2", "--ntasks-per-node=1", "--cpus-per-task=24", "--mem=80G", "--gres=gpu:4"):
        assert f"#SBATCH {line}\n" in script
    assert "export GAITWAY_HOSTS=2\n" in script
    assert is_bash(script)
    assert "srun" not in script_of(SlotKind("gpu", 4), "g", found, PLACE)
    with pytest.raises(Misconfigured, match="use 'apptainer'"):
        options(cpu={"hosts": [2]}, container={"kind": "pyxis", "image": "a/b:1"})


def test_pyxis_starts_the_worker_by_srun_and_passes_on_a_signal_that_srun_passes_on() -> None:
    script = script_of(CPU, "g", options(container={"kind": "pyxis", "image": "ghcr.io#a/b:1"}), PLACE)
    assert 'kill -USR1 "$worker"' in script
    mounts = '--container-mounts="$data:$data,$sockets:$sockets"'
    assert f"srun --ntasks=1 '--container-image=ghcr.io#a/b:1' {mounts}" in script
    assert is_bash(script)


def test_a_template_of_ones_own_has_the_lines_where_it_wants_them(tmp_path: Path) -> None:
    own = tmp_path / "own.sh"
    own.write_text("#!/bin/bash -l\n@OPTIONS@\n#SBATCH --mail-type=FAIL\nulimit -c 0\n@WORKER@\n")
    script = script_of(CPU, "g", options(template=own), PLACE)
    assert script.startswith("#!/bin/bash -l\n#SBATCH --job-name=g\n")
    assert "#SBATCH --mail-type=FAIL\nulimit -c 0\nset -u\n" in script
    own.write_text("#!/bin/bash\n@OPTIONS@\n")
    with pytest.raises(Misconfigured, match=r"/template: .* has no line @WORKER@"):
        script_of(CPU, "g", options(template=own), PLACE)
    with pytest.raises(Misconfigured, match=r"/template: .* cannot be read"):
        script_of(CPU, "g", options(template=tmp_path / "none"), PLACE)


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ("max = 0\n[cpu]", "/max: Input should be greater than or equal to 1"),
        ("[cpu]\npartition = 'a b'", "/cpu/partition: String should match"),
        ('[cpu]\npartition = "a\\n#SBATCH --x"', "/cpu/partition: String should match"),
        ("[cpu]\npartitions = 'a'", "/cpu/partitions: Extra inputs are not permitted"),
        ("[gpu]\ngres = 'gpu:2'", "/gpu: gres must contain {gpus}"),
        ("max = 3", "neither [cpu] nor [gpu] is there"),
        ("any = 'gpu'\n[cpu]", "any = 'gpu', but there is no [gpu]"),
        ("[cpu]\ntime = '2:00'", "cpu.time is 120 s, and 160 s of it are for starting and draining"),
        ("[cpu]\ntime = 'long'", "/cpu/time: String should match"),
        ("[cpu", "is not TOML"),
    ],
)
def test_what_is_wrong_in_the_file_is_named_with_its_place(tmp_path: Path, said: str, sentence: str) -> None:
    file = tmp_path / "slurm.toml"
    file.write_text(said)
    with pytest.raises(Misconfigured) as refusal:
        read_options(file, {})
    assert sentence in refusal.value.detail
    assert str(file) in refusal.value.detail


@pytest.mark.parametrize(
    ("time", "seconds"),
    [("90", 5400), ("2:30", 150), ("8:00:00", 28_800), ("1-2", 93_600), ("1-00:30:00", 88_200)],
)
def test_times_are_read_as_slurm_writes_them(time: str, seconds: int) -> None:
    assert seconds_of(time) == seconds


NODES = [
    NodeGroup("low", True, True, 2, 2, 16, 64_000, 3600.0),
    NodeGroup("low", True, True, 1, 4, 8, 64_000, 3600.0),
    NodeGroup("old", False, False, 2, 8, 64, 64_000, None),
]


@pytest.mark.parametrize(
    ("kind", "said", "sentence"),
    [
        (SlotKind("gpu", 4), {"gpu": {"gpus": [4], "cpus": 4, "mem": "8G"}}, None),
        (
            CPU,
            {"cpu": {"partition": "nix"}},
            "/cpu/partition: there is no partition 'nix'. Slurm has low, old.",
        ),
        (CPU, {"cpu": {"partition": "old"}}, "/cpu/partition: old is down: Slurm takes no jobs there now."),
        (
            SlotKind("gpu", 8),
            {"gpu": {"gpus": [8]}},
            "/gpu/gpus: 8 GPUs of one node are wanted; a node of partition low has at most 4.",
        ),
        (CPU, {"cpu": {"cpus": 17}}, "/cpu/cpus: 17 cores are wanted; a node of partition low has 16."),
        (
            CPU,
            {"cpu": {"mem": "1T"}},
            "/cpu/mem: 1048576 MiB are wanted; a node of partition low has 64000.",
        ),
        (CPU, {"cpu": {"time": "2:00:00"}}, "/cpu/time: 2:00:00 is more than partition low allows."),
    ],
)
def test_what_no_node_of_the_partition_has_is_named(
    kind: SlotKind, said: dict[str, Any], sentence: str | None
) -> None:
    found = read_options(None, said)
    assert what_is_wrong(kind, found.part(kind), NODES) == sentence


def test_a_host_count_that_no_partition_has_is_named() -> None:
    part = read_options(None, {"gpu": {}}).part(SlotKind("gpu", 1))
    wrong = what_is_wrong(SlotKind("gpu", 1, 4), part, NODES)
    assert wrong == "/gpu: 4 hosts are wanted, and partition low has 3."
    assert what_is_wrong(CPU, part, []) == (
        "/cpu/partition: there is no default partition; name one. Slurm has none that you may use."
    )
