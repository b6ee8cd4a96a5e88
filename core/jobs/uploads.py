"""The files that users sent and that jobs name."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Protocol, cast

from core.clips.options import ClipChoice
from core.clips.record import ARCHIVE, ClipFile, ClipStore
from core.environments.info import EnvironmentInfo
from core.environments.terms.inventory import Inventory
from core.environments.terms.page import task_of
from core.environments.terms.reference import Reference, compared_bodies, too_many_frames
from core.environments.terms.task import control_step_s
from core.errors import ClipsNotFound, Problem, Rejected
from core.jobs.spec import EnvironmentSpec
from core.patterns import matching
from core.uploads import library
from core.user_models.record import ModelStore

_CLIPS = "/environment/options/reference/clips"


class Uploads(Protocol):
    """The records of the files that users send."""

    @property
    def models(self) -> ModelStore:
        """Of users' own models."""
        ...

    @property
    def clips(self) -> ClipStore:
        """Of clip files."""
        ...


def clip_files_of(environment: EnvironmentSpec) -> tuple[str, ...]:
    """The ids of the clip files that an environment's options name, each once.

    The options may be wrong: they are read as far as they can be.
    """
    return tuple(dict.fromkeys(file for _, file in named_clips(environment)))


def named_clips(environment: EnvironmentSpec) -> Iterator[tuple[int, str]]:
    """The place of each choice of clips among the options, and the id of its file."""
    choices = _member(environment.options.get("reference"), "clips")
    for place, choice in enumerate(cast("list[object]", choices) if isinstance(choices, list) else ()):
        if isinstance(file := _member(choice, "file"), str):
            yield place, file


def archives_of(environment: EnvironmentSpec, uploads: Uploads) -> dict[str, str]:
    """The clip files that an environment names, each with the hash of its archive. They were checked."""
    found = {file: uploads.clips.find(file).description for file in clip_files_of(environment)}
    return {file: said.made[ARCHIVE].sha256 for file, said in found.items() if said is not None}


def check_clips(
    environment: EnvironmentSpec, info: EnvironmentInfo, uploads: Uploads, model: Callable[[], Inventory]
) -> None:
    """Refuse clips that do not exist, are not validated yet, move another body, lack what the job names, are
    to be mirrored and cannot be, or have more frames than a job has room for.

    info: the environment's row under its options. model: of its body. Raises Rejected.
    """
    reference = getattr(info.option_values, "reference", None)
    if not isinstance(reference, Reference):
        return
    find = cache(partial(library.find, store=uploads.clips))  # Many choices may be of one file.
    problems = [
        Problem(f"{_CLIPS}/{place}/{field}", detail)
        for place, choice in enumerate(reference.clips)
        for field, detail in _clip_problems(choice, environment, info, find)
    ]
    mirrored = [place for place, choice in enumerate(reference.clips) if choice.mirror]
    if mirrored and (why := model().no_mirror) is not None:
        problems += [Problem(f"{_CLIPS}/{place}/mirror", why) for place in mirrored]
    if not problems and (task := task_of(info, info.option_values)) is not None:
        step_s = control_step_s(task, model())
        num_frames = sum(_num_frames(choice, step_s, find) for choice in reference.clips)
        sizes, num_bodies = model().sizes, len(compared_bodies(reference, model()))
        if (why := too_many_frames(num_frames, sizes.nq, sizes.nv, num_bodies)) is not None:
            problems.append(Problem(_CLIPS, why))
    if problems:
        raise Rejected(" ".join(problem.detail for problem in problems[:5]), problems)


def _num_frames(choice: ClipChoice, step_s: float, find: Callable[[str], ClipFile]) -> int:
    """How many frames the chosen clips have, one for each control step."""
    described = find(choice.file).description
    clips = [] if described is None else described.clips
    names = [clip.name for clip in clips]
    wanted = names if choice.names is None else matching(choice.names, names)
    return sum(
        int((min(clip.seconds, choice.to_s or clip.seconds) - choice.from_s) / choice.speed / step_s) + 1
        for clip in clips
        if clip.name in wanted
    )


def _clip_problems(
    choice: ClipChoice,
    environment: EnvironmentSpec,
    info: EnvironmentInfo,
    find: Callable[[str], ClipFile],
) -> Iterator[tuple[str, str]]:
    """The field of each problem, and a sentence."""
    try:
        record = find(choice.file)
    except ClipsNotFound as error:
        yield "file", error.detail
        return
    if record.status == "refused":
        yield "file", f"The clips {record.id} were refused: {record.message}"
    elif record.description is None:
        yield "file", f"The clips {record.id} are still being validated; ask GET /clips/{record.id}."
    else:
        yield from _misfits(record, record.description.joints, environment, info)
        clips = record.description.clips
        names = [clip.name for clip in clips]
        wanted = names if choice.names is None else matching(choice.names, names)
        for pattern in choice.names or ():
            if not matching([pattern], names):
                known = ", ".join(names[:20])
                yield "names", f"No clip of {record.id} is called {pattern!r}; it has {known}."
        for clip in clips:
            end = clip.seconds + 1e-6
            if clip.name in wanted and max(choice.from_s, choice.to_s or 0.0) > end:
                past = "from_s" if choice.from_s > end else "to_s"
                what = f"the clip {clip.name!r}, which takes {clip.seconds:g} s"
                yield past, f"{past} is past the end of {what}."


def _misfits(
    record: ClipFile, joints: Sequence[str], environment: EnvironmentSpec, info: EnvironmentInfo
) -> Iterator[tuple[str, str]]:
    body = environment.options.get("model") if info.takes_model else environment.id
    if record.body == body:
        return
    known = info.parts.get("joints", ())
    if missing := [joint for joint in joints if joint not in known]:
        named = ", ".join(missing[:5])
        yield (
            "file",
            f"The clips {record.id} are of the body {record.body}, and {body} has no joints called {named}.",
        )


def _member(document: object, name: str) -> object:
    return cast("Mapping[str, object]", document).get(name) if isinstance(document, Mapping) else None
