"""`gaitway submit`, from a file, from options or from both; `gaitway rollout` runs a trained policy."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NoReturn, cast

import typer

from gaitway.cli.common import (
    AsJson,
    JobName,
    client_of,
    end_code,
    job_id,
    names_to_ids,
    print_json,
    wrong_usage,
)
from gaitway.cli.terminal import Console
from gaitway.cli.watch import page_of, print_what_it_waits_for, watch_job
from gaitway.client import Client
from gaitway.schema import JobView

# The fields of a job; every other name in `--set` is an option of its environment.
JOB_FIELDS = frozenset(
    {
        *(
            "kind",
            "name",
            "project",
            "labels",
            "note",
            "environment",
            "physics",
            "randomization",
            "seed",
            "seeds",
            "video",
            "battery",
            "recording",
            "notify",
        ),
        *(
            "resources",
            "priority",
            "timeout_s",
            "max_attempts",
            "algorithm",
            "checkpoints",
            "resume_from",
            "preemptible",
            "tracking",
        ),
        *("policy", "num_steps", "num_episodes", "deterministic"),
    }
)
# The option that says how long an algorithm without `num_timesteps` learns.
_LENGTHS = {"q_learning": "algorithm.num_episodes=2000"}

Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Any field, several times, e.g. algorithm.learning_rate=3e-4; or an option of the environment.",
    ),
]

Show = Annotated[
    list[str] | None,
    typer.Option(help="joints, contacts, centre_of_mass or transparent: drawn besides the body."),
]


def submit(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    environment: Annotated[str | None, typer.Argument(help="The environment, e.g. ant.")] = None,
    file: Annotated[str | None, typer.Option("--file", "-f", help="JSON of a job; `-` reads stdin.")] = None,
    num_timesteps: Annotated[
        int | None,
        typer.Option(help="Environment steps to train for (algorithms with num_timesteps)."),
    ] = None,
    seed: Annotated[int | None, typer.Option()] = None,
    seeds: Annotated[
        str | None, typer.Option(metavar="N,N,…", help="Several, trained side by side in one job.")
    ] = None,
    name: Annotated[str | None, typer.Option()] = None,
    project: Annotated[
        str | None, typer.Option(help="Whose members see it; needless with one project of your own.")
    ] = None,
    label: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE")] = None,
    notify: Annotated[
        list[str] | None, typer.Option(metavar="WEBHOOK", help="Told of this job; repeatable.")
    ] = None,
    priority: Annotated[
        str | None,
        typer.Option(metavar="low|normal|high", help="Comes first; trainings of a lower one make room."),
    ] = None,
    preemptible: Annotated[
        bool,
        typer.Option("--preemptible", help="Make room for users who have used less of late; go on later."),
    ] = False,
    camera: Annotated[
        list[str] | None, typer.Option(help="`track` or one of the model's; several are shown side by side.")
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Episodes that the video shows at the same time.")
    ] = None,
    show: Show = None,
    no_video: Annotated[bool, typer.Option("--no-video", help="Make no video.")] = False,
    assignments: Assignments = None,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Stay and show the progress.")] = False,
    as_json: AsJson = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Queue nothing: check the job, and print it with its defaults.")
    ] = False,
) -> None:
    """Queue a training (or, from a file, a rollout)."""
    spec = read(file) if file else {}
    if environment is not None and (environment.endswith(".json") or Path(environment).is_file()):
        raise wrong_usage(
            f"{environment} is a file: send the job in it by `gaitway submit -f {environment}`."
        )
    if environment is not None:
        spec["environment"] = environment
    if "environment" not in spec and spec.get("kind") != "rollout":
        raise wrong_usage(
            "Name an environment (`gaitway submit ant`), or a file with a job (`--file job.json`)."
        )
    cameras = [_value(one) for one in camera or ()]
    of_video = {"video.cameras": cameras, "video.episodes": episodes, "video.show": show}
    if no_video:
        _leave_out_the_video(spec, of_video)
    several = [_value(one) for one in seeds.split(",")] if seeds else None
    _put_given(
        spec,
        {
            "seed": seed,
            "seeds": several,
            "name": name,
            "project": project,
            "notify": notify,
            "priority": priority,
            "preemptible": preemptible or None,
            "algorithm.num_timesteps": num_timesteps,
            **of_video,
        },
    )
    if label:
        spec["labels"] = {**spec.get("labels", {}), **dict(_assignment(text) for text in label)}
    for text in assignments or ():
        assigned(spec, whole_path(text))
    name_the_algorithm(spec, num_timesteps)
    client = client_of(context)
    if isinstance(spec.get("environment"), dict):
        chosen = cast("dict[str, Any]", spec["environment"])
        names_to_ids(client, chosen.get("options"))
    if dry_run:
        print_json(client.check(spec))
        return
    follow(client, client.submit(spec), watch=watch, as_json=as_json)


def follow(client: Client, job: JobView, *, watch: bool, as_json: bool) -> NoReturn:
    """Tell of a job that was just sent, or stay and show it. Raises typer.Exit with the command's code."""
    if watch:
        job = watch_job(client, job, Console(stderr=as_json))
    if as_json:
        print_json(job)
    elif not watch:
        print(job.id)
        print(f"Its page: {page_of(client, job.id)}", file=sys.stderr)
        print_what_it_waits_for(client, job, Console(stderr=True))
    raise typer.Exit(end_code(job) if watch and job.is_final else 0)


def assigned(spec: dict[str, Any], text: str) -> None:
    """Set a field from `a.b.c=VALUE`; a VALUE that is JSON is read as JSON."""
    path, value = _assignment(text)
    put(spec, path, _value(value))


def option(text: str) -> str:
    """An option of an environment as `preview` takes it: the path that `submit` has for it will do, too."""
    return text.removeprefix("environment.options.")


def whole_path(text: str) -> str:
    """A name that is no field of a job is an option of its environment, as in `preview`."""
    first = text.partition("=")[0].partition(".")[0]
    return text if first in JOB_FIELDS else f"environment.options.{text}"


def name_the_algorithm(spec: dict[str, Any], num_timesteps: int | None = None) -> None:
    """Fill in the kind of an algorithm that is an object without one."""
    if not isinstance(spec.get("algorithm"), dict):
        return
    kind = spec["algorithm"].setdefault("kind", "ppo")
    if num_timesteps is not None and kind in _LENGTHS:
        raise wrong_usage(
            f"{kind} has no num_timesteps; say how long it learns by --set, e.g. --set {_LENGTHS[kind]}."
        )


def _put_given(spec: dict[str, Any], fields: Mapping[str, Any]) -> None:
    for path, value in fields.items():
        if value not in (None, []):
            put(spec, path, value)


def _leave_out_the_video(spec: dict[str, Any], of_video: Mapping[str, Any]) -> None:
    fields = [path.removeprefix("video.") for path, value in of_video.items() if value not in (None, [])]
    if fields:
        raise wrong_usage(f"--no-video leaves nothing for {', '.join(fields)} to say; leave one of them out.")
    spec["video"] = None


def put(spec: dict[str, Any], path: str, value: Any) -> None:
    """Set `a.b.c` in nested dicts, creating those that are missing. Raises typer.Exit if one is no dict."""
    *above, last = path.split(".")
    place = spec
    for part in above:
        inner: Any = place.setdefault(part, {})
        if part == "environment" and isinstance(inner, str):
            inner = place[part] = {"id": inner}
        if not isinstance(inner, dict):
            raise wrong_usage(f"--set {path}: {part!r} is not an object.")
        place = cast("dict[str, Any]", inner)
    place[last] = value


def _assignment(text: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not sign or not name:
        raise wrong_usage(f"{text!r} is not of the form NAME=VALUE.")
    return name, value


def _value(text: str) -> Any:
    """The parsed value if the text is JSON, otherwise the text itself."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def read(file: str) -> dict[str, Any]:
    """The JSON object in a file; `-` is stdin. Raises typer.Exit."""
    try:
        text = sys.stdin.read() if file == "-" else Path(file).read_text(encoding="utf-8")
        document = json.loads(text)
    except OSError as error:
        raise wrong_usage(f"{file} cannot be read: {error.strerror}.") from None
    except ValueError as error:
        raise wrong_usage(f"{file} is not JSON: {error}.") from None
    if not isinstance(document, dict):
        raise wrong_usage(f"{file} does not hold a JSON object.")
    return cast("dict[str, Any]", document)


def rollout(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    job: JobName,
    step: Annotated[
        int | None, typer.Option(help="The checkpoint of this step; by default the newest.")
    ] = None,
    best: Annotated[
        bool, typer.Option("--best", help="The policy of the best evaluation, not the last one.")
    ] = False,
    episodes: Annotated[int | None, typer.Option(min=1, help="How many; by default one.")] = None,
    num_steps: Annotated[int | None, typer.Option(min=1, help="The most steps of an episode.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the episodes' starts; see --policy-seed for whose policy acts.")
    ] = None,
    policy_seed: Annotated[
        int | None, typer.Option(help="Whose policy, of a job with several seeds; by default the first's.")
    ] = None,
    name: Annotated[str | None, typer.Option()] = None,
    no_video: Annotated[bool, typer.Option("--no-video", help="Make no video.")] = False,
    record: Annotated[
        bool, typer.Option("--record", help="Keep recording.h5, with the activations of all layers.")
    ] = False,
    assignments: Assignments = None,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Stay and show the progress.")] = False,
    as_json: AsJson = False,
) -> None:
    """Run the policy of a training in the training's environment: trajectory, summary, video."""
    if best and step is not None:
        raise wrong_usage("--step and --best exclude each other.")
    client = client_of(context)
    full_id = job_id(client, job)
    policy: dict[str, Any] = {"kind": "checkpoint", "job": full_id}
    policy |= {} if step is None else {"step": step}
    policy |= {"which": "best"} if best else {}
    policy |= {} if policy_seed is None else {"seed": policy_seed}
    fields = {"num_episodes": episodes, "num_steps": num_steps, "seed": seed, "name": name}
    spec: dict[str, Any] = {"kind": "rollout", "policy": policy}
    spec |= {field: value for field, value in fields.items() if value is not None}
    if no_video:
        spec["video"] = None
    if record:
        spec["recording"] = True
    for text in assignments or ():
        path = whole_path(text)
        if path.startswith("environment.options.") and "environment" not in spec:
            spec["environment"] = client.get(full_id).spec["environment"]
        assigned(spec, path)
    follow(client, client.submit(spec), watch=watch, as_json=as_json)
