"""`gaitway rollout`: what a trained policy does, in episodes of its own."""

from typing import Annotated, Any

import typer

from gaitway.cli.common import AsJson, JobName, client_of, job_id
from gaitway.cli.errors import wrong_usage
from gaitway.cli.submit import Assignments, assigned, follow, whole_path


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
    said = {"num_episodes": episodes, "num_steps": num_steps, "seed": seed, "name": name}
    spec: dict[str, Any] = {"kind": "rollout", "policy": policy}
    spec |= {field: value for field, value in said.items() if value is not None}
    if no_video:
        spec["video"] = None
    for text in assignments or ():
        path = whole_path(text)
        if path.startswith("environment.options.") and "environment" not in spec:
            spec["environment"] = client.get(full_id).spec["environment"]
        assigned(spec, path)
    follow(client, client.submit(spec), watch=watch, as_json=as_json)
