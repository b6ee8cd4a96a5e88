"""What a confined process can still do, tried by one: it says what each attempt came to."""

import json
import os
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from worker.confinement import landlock
from worker.confinement.confinement import Limits

ROOT = Path(__file__).parents[4]
NEEDS_LANDLOCK = pytest.mark.skipif(not landlock.version(), reason="this kernel has no Landlock")
# `tried` returns the name of the error, or what came out.
_PROBE = """
import ctypes, json, os, resource, signal, socket, sys
from pathlib import Path
from worker.confinement import confinement, landlock, privileges, seccomp
{change}
here = Path.cwd()
try:
    layers = confinement.confine(confinement.Limits(cpu_s=7), here, strictly={strictly})
except confinement.Unconfined as error:
    print(json.dumps({{"unconfined": str(error)}}))
    sys.exit()

def tried(what):
    try:
        return what()
    except Exception as error:
        return type(error).__name__

def call(*numbers):
    libc = ctypes.CDLL(None, use_errno=True)
    return 0 if libc.syscall(*map(ctypes.c_long, numbers)) >= 0 else ctypes.get_errno()

found = {{name: tried(what) for name, what in {{{attempts}}}.items()}}
print(json.dumps({{"layers": layers, **found}}))
"""


def probe(
    folder: Path,
    attempts: dict[str, str],
    *,
    change: str = "",
    strictly: bool = True,
    python: str = sys.executable,
) -> dict[str, Any]:
    lines = ", ".join(f"{name!r}: lambda: {code}" for name, code in attempts.items())
    program = _PROBE.format(attempts=lines, change=change, strictly=strictly)
    done = subprocess.run(
        [python, "-c", program],
        cwd=folder,
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@NEEDS_LANDLOCK
def test_it_reads_and_writes_nothing_but_its_own_folder(tmp_path: Path) -> None:
    secret, folder = tmp_path / "secret", tmp_path / "spool"
    secret.write_text("word")
    folder.mkdir()
    (folder / "model").write_text("body")
    found = probe(
        folder,
        {
            "own": "(here / 'model').read_text()",
            "kept": "(here / 'answer').write_text('four')",
            "replaced": "os.replace('answer', 'answer.json')",
            "secret": f"open({str(secret)!r}).read()",
            "listed": f"os.listdir({str(tmp_path)!r})",
            "above": f"open({str(tmp_path / 'new')!r}, 'w')",
            "over": f"open({str(secret)!r}, 'w')",
            "moved": f"os.rename({str(secret)!r}, 'mine')",
            "linked": "os.symlink('/etc/passwd', 'link')",
            "hostname": "open('/etc/hostname').read()",
            "checkout": f"open({str(ROOT / 'pyproject.toml')!r}).read()",
            "parents_environment": "open(f'/proc/{os.getppid()}/environ').read()",
            "parents_memory": "open(f'/proc/{os.getppid()}/mem').read()",
        },
    )
    assert "files" in found.pop("layers")
    assert [found.pop(name) for name in ("own", "kept", "replaced")] == ["body", 4, None]
    assert set(found.values()) == {"PermissionError"}, found
    assert secret.read_text() == "word"


def test_it_reaches_no_network_and_no_other_process(tmp_path: Path) -> None:
    attempts = {
        "tcp": "socket.socket().connect(('127.0.0.1', {port}))",
        "unix": "socket.socket(socket.AF_UNIX)",
        "udp": "socket.socket(type=socket.SOCK_DGRAM)",
        "netlink": "socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)",
        "signal": "os.kill(os.getppid(), 0)",
        "everybody": "os.kill(-1, 0)",
        "limits": "resource.prlimit(os.getppid(), resource.RLIMIT_CORE, (0, 0))",
    }
    with socket.create_server(("127.0.0.1", 0)) as server:
        attempts["tcp"] = attempts["tcp"].format(port=server.getsockname()[1])
        found = probe(tmp_path, attempts, strictly=False)
    assert "calls" in found.pop("layers")
    assert set(found.values()) == {"PermissionError"}, found


def test_l7_it_cannot_leave_the_group_in_which_it_is_killed(tmp_path: Path) -> None:
    found = probe(
        tmp_path,
        {
            "session": "os.setsid()",
            "group": "os.setpgid(0, 0)",
            "of_a_child": "os.waitpid(os.fork() or os._exit(tried(os.setsid) != 'PermissionError'), 0)[1]",
        },
        strictly=False,
    )
    assert "calls" in found.pop("layers")
    assert found.pop("of_a_child") == 0
    assert set(found.values()) == {"PermissionError"}, found


def test_l7_the_number_of_its_processes_is_bounded(tmp_path: Path) -> None:
    found = probe(tmp_path, {"most": "resource.getrlimit(resource.RLIMIT_NPROC)"}, strictly=False)
    soft, hard = found["most"]
    assert soft == hard
    assert 512 <= soft < 100_000


def test_it_makes_no_namespace_and_no_ring_and_is_nobodys_debugger(tmp_path: Path) -> None:
    newuser, attach, enosys = 0x10000000, 16, 38
    found = probe(
        tmp_path,
        {
            "unshare": f"call(272 if os.uname().machine == 'x86_64' else 97, {newuser})",
            "clone": f"call(56 if os.uname().machine == 'x86_64' else 220, {newuser}, 0, 0, 0, 0)",
            "ptrace": f"call(101 if os.uname().machine == 'x86_64' else 117, {attach}, os.getppid(), 0, 0)",
            "ring": "call(425, 1, 0)",
            "clone3": "call(435, 0, 0)",
        },
        strictly=False,
    )
    assert found.pop("clone3") == enosys
    del found["layers"]
    assert set(found.values()) == {1}, found  # EPERM


def test_it_holds_no_capability_and_none_of_its_programs_gets_any(tmp_path: Path) -> None:
    status = "dict(line.split(':\\t') for line in open('/proc/self/status').read().splitlines())"
    found = probe(
        tmp_path, {"status": status, "cpu": "resource.getrlimit(resource.RLIMIT_CPU)[1]"}, strictly=False
    )
    capabilities = {found["status"][f"Cap{kind}"] for kind in ("Inh", "Prm", "Eff", "Amb")}
    assert capabilities == {"0" * 16}
    assert found["status"]["NoNewPrivs"] == "1"
    assert found["status"]["Seccomp"] == "2"
    assert found["cpu"] == 7


@pytest.mark.parametrize(
    ("change", "layer"),
    [
        ("landlock._CREATE_RULESET = 100_000; landlock.version = lambda: 7", "files"),
        ("landlock.version = lambda: 0", "files"),
        ("seccomp._PR_SET_SECCOMP = -1", "calls"),
        ("seccomp._PROCESSORS.clear()", "calls"),
        ("privileges._PR_SET_NO_NEW_PRIVS = -1", "privileges"),
        ("privileges._CAPABILITIES_VERSION_3 = 1", "privileges"),
        ("del os.sched_getaffinity", "limits"),
    ],
)
def test_where_a_layer_fails_nothing_is_read(change: str, layer: str, tmp_path: Path) -> None:
    if layer == "calls" and not landlock.version():
        pytest.skip("Landlock comes before, and is not here")
    said = probe(tmp_path, {}, change=change)["unconfined"]
    assert said.startswith(f"{layer}: ")


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """One that every user reaches, as pytest's own are not."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes others")
def test_root_becomes_a_user_of_its_own_who_reads_no_file_of_roots(open_folder: Path) -> None:
    python = Path("/usr/bin/python3")
    if (
        not python.exists()
        or subprocess.check_output([python, "-c", "import sys; print(sys.version_info > (3, 11))"])
        != b"True\n"
    ):
        pytest.skip("this system has no Python of its own that is new enough")
    if not all(parent.stat().st_mode & stat.S_IXOTH for parent in Path(__file__).resolve().parents):
        pytest.skip("this checkout is in a private folder, where that user could not read these modules")
    secret = open_folder / "secret"
    secret.write_text("word")
    secret.chmod(0o600)
    folder = open_folder / "spool"
    folder.mkdir(mode=0o700)
    (folder / "model").write_text("body")
    open_folder.chmod(0o755)
    found = probe(
        folder,
        {
            "users": "os.getresuid()",
            "groups": "os.getgroups()",
            "own": "(here / 'model').read_text()",
            "kept": "(here / 'answer').write_text('four')",
            "secret": f"open({str(secret)!r}).read()",
            "back": "os.setuid(0)",
        },
        change="landlock.version = lambda: 0",
        python=str(python),
    )
    assert found["layers"] == ["limits", "user", "privileges", "calls"]
    assert set(found["users"]) == {found["users"][0]}
    assert found["users"][0] >= 2_000_000_000
    assert (found["groups"], found["own"], found["kept"]) == ([], "body", 4)
    assert (found["secret"], found["back"]) == ("PermissionError", "PermissionError")


def test_limits_survive_their_way_to_the_process() -> None:
    limits = Limits(wall_s=1.5, cpu_s=2, memory_bytes=3, file_bytes=4, num_files=5, num_cores=6)
    assert Limits.of(limits.arguments()) == limits
