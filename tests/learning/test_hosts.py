"""Two processes share a run, one on each host, and it ends as in one process that has the devices of both."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from gaitway.service.embedded.processes import free_ports
from tests.compiling import compiling_quickly


@pytest.mark.timeout(300)
def test_two_hosts_learn_what_one_learns_with_both_devices(tmp_path: Path) -> None:
    both = {**os.environ, **compiling_quickly(), "JAX_PLATFORMS": "cpu"}
    alone = both | compiling_quickly("--xla_force_host_platform_device_count=2")
    port, (together, apart) = free_ports(1)[0], [tmp_path / name for name in ("together", "apart")]
    started = [
        _started(1, 0, port, together, alone),
        _started(2, 0, port, apart, both),
        _started(2, 1, port, apart, both),
    ]
    assert [process.wait() for process in started] == [0, 0, 0]
    of_one, of_two = ({f.name: f.read_bytes() for f in folder.iterdir()} for folder in (together, apart))
    assert sorted(of_one) == ["1024", "512"]
    assert of_one == {name: of_two[name] for name in of_one}
    assert of_two["resumed"] == of_two["1024"]


def _started(
    num_hosts: int, rank: int, port: int, out: Path, variables: Mapping[str, str]
) -> "subprocess.Popen[bytes]":
    out.mkdir(exist_ok=True)
    command = [
        sys.executable,
        "-m",
        "tests.learning.on_hosts",
        str(num_hosts),
        str(rank),
        str(port),
        str(out),
    ]
    return subprocess.Popen(command, env=variables)
