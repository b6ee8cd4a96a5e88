"""The batch script of a worker.

It consists of sbatch's options, the site's own lines, and the worker. A template of one's own is any script
with a line `@OPTIONS@` among its first, and a line `@WORKER@` where the worker is to run; `@SETUP@` stands
for modules and own lines.
"""

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from core.errors import Misconfigured
from core.jobs.slots import SlotKind
from worker.cluster.options import Container, GpuPart, SlurmOptions, Tunnel

TEMPLATE = """#!/bin/bash
@OPTIONS@
@SETUP@
@WORKER@
"""

# What Slurm sends to a script and its processes, and how often, depends on its version and configuration. So
# the script only passes it on, and waits. The tunnel ignores it: a draining worker needs the stores.
_WORKER = """set -u
umask 077
disk=${SLURM_TMPDIR:-${TMPDIR:-/tmp}}
data=$(mktemp -d "$disk/gaitway-$SLURM_JOB_ID-XXXXXX") || exit 73
sockets=/tmp/${data##*/}.s
mkdir -m 700 "$sockets" || exit 73
exec 9>"$data/lock"
flock -n 9
# What jobs have left that were killed: nobody holds their locks.
find "$disk" -maxdepth 1 -user "$(id -u)" -name 'gaitway-[0-9]*-??????' -mmin +1 2>/dev/null |
  while read -r old; do
    [ ! -e "$old/lock" ] || (flock -n 8 && rm -rf "$old" "/tmp/${old##*/}.s") 8<>"$old/lock"
  done
tunnel=
leave() {
  trap '' TERM INT USR1
  # A worker that was killed leaves a child that still drains, and holds the lock as it does.
  exec 9>&-
  flock -w @LEAVING@ "$data/lock" true
  [ -z "$tunnel" ] || kill -KILL -- "-$tunnel" 2>/dev/null
  rm -rf "$data" "$sockets"
}
trap leave EXIT
worker= told=
tell() { told=1; [ -z "$worker" ] || kill -@SIGNAL@ "$worker" 2>/dev/null; }
trap tell TERM INT USR1
@TUNNEL@
mkdir "$data/settings"
for file in @SETTINGS@/*; do
  sed -e "s|@FOLDER@|$sockets|g" @PORTS@ "$file" >"$data/settings/${file##*/}" || exit 74
done
export GAITWAY_SECRETS_DIR=$data/settings GAITWAY_DATA_DIR=$data/worker
export GAITWAY_IDLE_EXIT=@IDLE@ GAITWAY_GRACE=@GRACE@ GAITWAY_START_MARGIN=@START_MARGIN@
ends=${SLURM_JOB_END_TIME:-}
[ -n "$ends" ] || ends=$(date -d "$(timeout 20 squeue -h -j "$SLURM_JOB_ID" -o %e)" +%s 2>/dev/null) || ends=
[ -z "$ends" ] || export GAITWAY_ENDS_AT=$ends
mem=${SLURM_MEM_PER_NODE:-0}
[ "$mem" -lt 1024 ] || export GAITWAY_MEMORY_LIMIT=$((mem * 95 / 100))MiB
@DEVICE@
@ENVIRONMENT@
[ -z "$told" ] || exit 0
@COMMAND@ &
worker=$!
while :; do
  wait "$worker"
  status=$?
  kill -0 "$worker" 2>/dev/null || break
done
exit "$status"
"""

# The script on the first host runs itself on each of them; ranks and addresses follow from Slurm's variables.
# srun passes USR1 on, and takes SIGTERM for itself. Where one host's worker has ended, the others end, too.
_GANG = """if [ "${1:-}" != task ]; then
  export GAITWAY_HOSTS=@HOSTS@
  gang= told=
  tell() { told=1; [ -z "$gang" ] || kill -USR1 "$gang" 2>/dev/null; }
  trap tell TERM INT USR1
  srun --ntasks-per-node=1 --cpus-per-task="$SLURM_CPUS_PER_TASK" --kill-on-bad-exit=0 --wait=@WAIT@ \\
    bash -c "$(cat "$0")" "$0" task &
  gang=$!
  [ -z "$told" ] || kill -USR1 "$gang"
  while :; do
    wait "$gang"
    status=$?
    kill -0 "$gang" 2>/dev/null || exit "$status"
  done
fi
"""

# Job control gives the loop a process group of its own, which `leave` ends. The ports are below those that
# Linux gives to outgoing connections.
_TUNNEL = """ports=()
for number in @NUMBERS@; do
  port=$((20000 + RANDOM % 12000))
  while (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; do port=$((port + 1)); done
  ports+=("$port")
done
set -m
(
  trap '' TERM INT USR1
  exec 9>&-
  while :; do
    ssh -N -T -o ExitOnForwardFailure=yes -o ServerAliveInterval=10 -o ServerAliveCountMax=3 \\
      -o StreamLocalBindUnlink=yes -o StreamLocalBindMask=0177 @SSH@ </dev/null 2>"$data/ssh.now"
    tee -a "$data/ssh" <"$data/ssh.now" >&2
    sleep 1
  done
) &
tunnel=$!
disown "$tunnel"  # bash reports nothing when it is killed
set +m
for _ in $(seq 150); do
  @IS_OPEN@ && break
  [ -z "$told" ] || exit 0
  sleep 0.2
done
if ! @IS_OPEN@; then
  echo "ssh to @HOST@ has not forwarded the stores within 30 s: $(tail -n 1 "$data/ssh" 2>/dev/null)"
  exit 69
fi"""


@dataclass(frozen=True)
class Place:
    """Where a service keeps what its allocations need. settings: a folder of files, one for each variable.

    logs: a folder. Every node sees both. forwards, ports: as `worker.cluster.stores` has them.
    """

    settings: Path
    logs: Path
    command: str
    forwards: Sequence[str] = ()
    ports: int = 0


def script_of(
    kind: SlotKind, name: str, options: SlurmOptions, place: Place, exclude: Sequence[str] = ()
) -> str:
    """The batch script of a worker of this kind. name: the job's; exclude: nodes that it must not run on.

    Raises Misconfigured for a template that lacks a line.
    """
    template = TEMPLATE
    if options.template is not None:
        template = _read(options.template)
    parts = {
        "OPTIONS": "\n".join(f"#SBATCH {line}" for line in _directives(kind, name, options, place, exclude)),
        "SETUP": "\n".join([*(f"module load {module}" for module in options.modules), options.setup]).strip(),
        "WORKER": _worker(kind, options, place),
    }
    return re.sub(r"^@(OPTIONS|SETUP|WORKER)@$", lambda found: parts[found[1]], template, flags=re.MULTILINE)


def _read(file: Path) -> str:
    try:
        text = file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise Misconfigured(f"/template: {file} cannot be read: {error}.") from None
    for name in ("OPTIONS", "WORKER"):
        if not re.search(rf"^@{name}@$", text, re.MULTILINE):
            raise Misconfigured(f"/template: {file} has no line @{name}@; `--print-template` shows ours.")
    if not text.startswith("#!"):
        raise Misconfigured(f"/template: {file} does not begin with #!/bin/bash, which sbatch asks for.")
    return text


def _directives(
    kind: SlotKind, name: str, options: SlurmOptions, place: Place, exclude: Sequence[str]
) -> list[str]:
    part = options.part(kind)
    lines = [f"--job-name={name}"]
    named = {name: getattr(part, name) for name in ("partition", "account", "qos", "constraint", "time")}
    lines += [f"--{name}={value}" for name, value in named.items() if value is not None]
    lines += [f"--nodes={kind.hosts}", "--ntasks-per-node=1"]
    number = kind.gpus if isinstance(part, GpuPart) else 1
    lines.append(f"--cpus-per-task={part.cpus * number}")
    amount = part.mem.rstrip("KMGT")
    lines.append(f"--mem={int(amount) * number}{part.mem[len(amount) :]}")
    if isinstance(part, GpuPart):
        lines.append(f"--gres={part.gres.format(gpus=kind.gpus)}")
    lines += [
        f"--output={place.logs}/%j.log",
        "--open-mode=append",
        f"--signal=B:TERM@{options.warning_s}",
        "--requeue",
    ]
    if exclude:
        lines.append(f"--exclude={','.join(exclude)}")
    return [*lines, *part.options]


def _worker(kind: SlotKind, options: SlurmOptions, place: Place) -> str:
    environment = {"GAITWAY_DEVICE": "cpu"} if kind.accelerator == "cpu" else {}
    device = 'export GAITWAY_DEVICE="gpu:${CUDA_VISIBLE_DEVICES:-0}"' if kind.accelerator != "cpu" else ""
    exports = {**environment, **options.environment}
    container = options.container
    parts = {
        # srun passes this one on to its processes, and takes SIGTERM for itself.
        "SIGNAL": "USR1" if container is not None and container.kind == "pyxis" else "TERM",
        "TUNNEL": _tunnel(options.tunnel, place) if isinstance(options.tunnel, Tunnel) else "",
        "SETTINGS": shlex.quote(str(place.settings)),
        "PORTS": " ".join(f'-e "s|@PORT{number}@|${{ports[{number}]}}|g"' for number in range(place.ports)),
        "IDLE": f"{options.idle:g}",
        "GRACE": f"{options.grace:g}",
        "LEAVING": f"{options.grace + 15:g}",
        "START_MARGIN": f"{options.start_margin:g}",
        "DEVICE": device,
        "ENVIRONMENT": "\n".join(f"export {name}={shlex.quote(value)}" for name, value in exports.items()),
        "COMMAND": options.command or place.command if container is None else _contained(container, kind),
    }
    gang = {"HOSTS": str(kind.hosts), "WAIT": f"{options.grace + 20:.0f}"}
    return (_filled(_GANG, gang) if kind.hosts > 1 else "") + _filled(_WORKER, parts).strip()


def _filled(text: str, parts: dict[str, str]) -> str:
    names = "|".join(parts)
    return re.sub(rf"@({names})@", lambda found: parts[found[1]], text)


def _tunnel(tunnel: Tunnel, place: Place) -> str:
    ssh = shlex.join(tunnel.ssh)
    for forward in place.forwards:
        there = forward.replace("@FOLDER@", "$sockets")
        there = re.sub(r"@PORT(\d+)@", r"${ports[\1]}", there)
        ssh += f' -L "{there}"'
    ssh += " " + shlex.quote(tunnel.destination)
    # ssh opens all of them, or none.
    first = place.forwards[0].split(":", 1)[0].replace("@FOLDER@", "$sockets")
    if "@PORT" in place.forwards[0]:
        is_open = '(exec 3<>"/dev/tcp/127.0.0.1/${ports[0]}") 2>/dev/null'
    else:
        is_open = f'[ -S "{first}" ]'
    parts = {
        "NUMBERS": " ".join(map(str, range(place.ports))),
        "SSH": ssh,
        "IS_OPEN": is_open,
        "HOST": tunnel.host,
    }
    return _filled(_TUNNEL, parts)


def _contained(container: Container, kind: SlotKind) -> str:
    binds = ("$data", "$sockets")
    own = shlex.join(container.options)
    if container.kind == "apptainer":
        words = ["apptainer", "exec", *(["--nv"] if kind.accelerator == "gpu" else [])]
        bound = " ".join(f'--bind "{folder}"' for folder in binds)
        parts = (" ".join(words), bound, own, shlex.quote(container.image), container.command)
    else:
        mounts = ",".join(f"{folder}:{folder}" for folder in binds)
        image = shlex.quote(f"--container-image={container.image}")
        parts = ("srun --ntasks=1", image, f'--container-mounts="{mounts}"', own, container.command)
    return " ".join(part for part in parts if part)
