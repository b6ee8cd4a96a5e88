"""Child processes: how they are started and ended, and what a training process finds around itself."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

import worker
from worker.host.child import TrainingProcess, collect, environment, kill, launch, memory_variables

ROOT = Path(worker.__file__).parents[1]

# Its child prints where it stands, and where it found this package.
_PARENT = """
import os, sys
from pathlib import Path
from worker.host.child import TrainingProcess
spool = Path(sys.argv[1])
code = "import os, worker; print(os.getcwd()); print(worker.__file__)"
with open(os.devnull) as lock:
    process = TrainingProcess((sys.executable, "-c", code), spool, spool.parent, "cpu", [lock.fileno()])
print(*process.lines(), sep="\\n")
list(process.messages())
process.poll(10)
"""


def test_it_stands_in_its_spool_and_finds_the_code_of_a_checkout_that_is_not_installed(
    tmp_path: Path,
) -> None:
    checkout, spool = tmp_path / "checkout", tmp_path / "spool"
    spool.mkdir()
    for package in ("core", "worker"):
        shutil.copytree(ROOT / package, checkout / package, ignore=shutil.ignore_patterns("__pycache__"))
    done = subprocess.run(
        [sys.executable, "-c", _PARENT, str(spool)], cwd=checkout, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(spool), str(checkout / "worker" / "__init__.py")]


def test_it_gets_no_setting_of_the_service_but_where_its_data_are(tmp_path: Path) -> None:
    base = {"GAITWAY_S3_SECRET_KEY": "secret", "GAITWAY_DATA_DIR": "elsewhere", "HOME": "/theirs"}
    given = environment("cpu", tmp_path, base)
    assert {name for name in given if name.startswith("GAITWAY_")} == {"GAITWAY_DATA_DIR"}
    assert (given["GAITWAY_DATA_DIR"], given["HOME"]) == (str(tmp_path), "/theirs")


@pytest.mark.parametrize(
    "name",
    [
        *(
            "AWS_ACCESS_KEY_ID",
            "AWS_SESSION_TOKEN",
            "PGPASSWORD",
            "PGPASSFILE",
            "PGHOST",
            "REDIS_URL",
            "REDISCLI_AUTH",
        ),
        *(
            "DATABASE_URL",
            "MINIO_ROOT_USER",
            "WANDB_API_KEY",
            "WEED_JWT_SIGNING_KEY",
            "S3_BUCKET",
            "HF_TOKEN",
        ),
        *(
            "GITHUB_TOKEN",
            "SSH_AUTH_SOCK",
            "OPENAI_API_KEY",
            "MY_SECRET",
            "DB_PASSWORD",
            "smtp_passwd",
            "SENTRY_DSN",
        ),
    ],
)
def test_it_gets_nobody_elses_secret(name: str, tmp_path: Path) -> None:
    assert name not in environment("cpu", tmp_path, {name: "it"})


def test_it_gets_no_address_with_a_password(tmp_path: Path) -> None:
    base = {"HTTPS_PROXY": "http://me:word@proxy:3128", "BROKER": "amqp://:word@host/1"}
    assert base.keys().isdisjoint(environment("cpu", tmp_path, base))


@pytest.mark.parametrize(
    "name",
    [
        *("PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "XDG_CACHE_HOME", "LD_LIBRARY_PATH", "XAUTHORITY"),
        *(
            "XLA_FLAGS",
            "JAX_COMPILATION_CACHE_DIR",
            "NCCL_DEBUG",
            "CUDA_CACHE_PATH",
            "WARP_CACHE_PATH",
            "MUJOCO_GL",
        ),
        *(
            "LP_NUM_THREADS",
            "MALLOC_ARENA_MAX",
            "OMP_NUM_THREADS",
            "SSL_CERT_FILE",
            "HTTPS_PROXY",
            "KEYBOARD",
        ),
    ],
)
def test_it_keeps_what_libraries_are_told(name: str, tmp_path: Path) -> None:
    assert environment("cpu", tmp_path, {name: "http://it"})[name] == "http://it"


def test_a_users_own_folder_of_modules_stays_after_ours(tmp_path: Path) -> None:
    given = environment("cpu", tmp_path, {"PYTHONPATH": "/theirs"})
    assert given["PYTHONPATH"].split(os.pathsep) == [str(ROOT), "/theirs"]


def test_a_gpu_is_numbered_as_its_device_files_are(tmp_path: Path) -> None:
    given = environment("gpu:1", tmp_path, {})
    assert (given["CUDA_VISIBLE_DEVICES"], given["CUDA_DEVICE_ORDER"]) == ("1", "PCI_BUS_ID")


def test_a_process_on_several_gpus_sees_those(tmp_path: Path) -> None:
    assert environment("gpu:1,3", tmp_path, {})["CUDA_VISIBLE_DEVICES"] == "1,3"


def test_a_line_without_an_end_is_cut_and_what_follows_is_heard(tmp_path: Path) -> None:
    print_them = "print('x' * 10**6); print('after it')"
    with Path(os.devnull).open() as lock:
        process = TrainingProcess(
            (sys.executable, "-c", print_them), tmp_path, tmp_path, "cpu", [lock.fileno()]
        )
    assert list(process.lines()) == ["x" * 4000, "after it"]
    assert list(process.messages()) == []
    assert process.poll(10) == 0


def test_a_child_inherits_the_named_descriptors_and_no_other() -> None:
    (named, other), list_them = os.pipe(), "import os; print(*os.listdir('/proc/self/fd'))"
    os.set_inheritable(other, True)
    with launched(list_them, fds=[named]) as child:
        output, _ = collect(child, 10)
    assert str(named) in output.split()
    assert str(other) not in output.split()
    os.close(named)
    os.close(other)


def test_what_a_child_writes_is_kept_up_to_a_bound() -> None:
    with launched("import sys; print('x' * 10**7); print('out'); print('err', file=sys.stderr)") as child:
        output, errors = collect(child, 30)
    assert (len(output), output[-5:], errors, child.returncode) == (2**20, "\nout\n", "err\n", 0)


@pytest.mark.parametrize(
    "code", ["import time; time.sleep(1000)", "import os; os.close(1); os.close(2); input()"]
)
def test_a_child_that_takes_too_long_is_ended(code: str) -> None:
    with launched(code, stdin=subprocess.PIPE) as child:
        with pytest.raises(subprocess.TimeoutExpired):
            collect(child, 0.5)
        assert child.returncode == -signal.SIGKILL


def test_killing_a_child_ends_what_it_started_and_a_child_in_our_group_ends_alone() -> None:
    start_one = "import subprocess, time; print(subprocess.Popen(['sleep', '1000']).pid, flush=True); input()"
    with launched(start_one, stdin=subprocess.PIPE) as child:
        assert child.stdout is not None
        started = psutil.Process(int(child.stdout.readline()))
        kill(child)
        assert not started.is_running() or started.status() == psutil.STATUS_ZOMBIE
    with launched("input()", stdin=subprocess.PIPE, in_own_session=False) as child:
        assert os.getpgid(child.pid) == os.getpgrp()
        kill(child)
        assert child.returncode == -signal.SIGKILL


def launched(code: str, **options: Any) -> "subprocess.Popen[bytes]":
    command, pipe = [sys.executable, "-c", code], subprocess.PIPE
    return launch(command, os.environ, stdout=pipe, stderr=pipe, **options)


def test_a_process_takes_no_more_than_its_part_of_a_gpu() -> None:
    outer = {"A": "1", "XLA_PYTHON_CLIENT_ALLOCATOR": "platform", "XLA_PYTHON_CLIENT_MEM_FRACTION": ".9"}
    assert memory_variables(outer, None) == outer
    assert memory_variables(outer, 0.25) == {
        "A": "1",
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        "XLA_CLIENT_MEM_FRACTION": "0.250000",
    }
