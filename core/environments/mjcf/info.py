"""The catalog's row of a user's own model."""

from typing import Annotated

from pydantic import Field

from core.environments.info import EnvironmentInfo
from core.environments.mjcf.edit_options import ModelEdits
from core.environments.terms.task import TaskOptions, varied
from core.physics.availability import BodySize, Rule

ModelId = Annotated[
    str, Field(pattern=r"^sha256:[0-9a-f]{64}$", description="The id that `POST /models` returned.")
]


class MjcfOptions(TaskOptions):
    """A user's model with its reward, observation and termination terms; only the model has no default."""

    model: ModelId
    edits: ModelEdits = Field(
        default=ModelEdits(),
        description="Changes of the model before it is compiled: servos, contacts, pose.",
    )


INFO = EnvironmentInfo(
    id="mjcf",
    description="Your own model (POST /models); terms define its reward, its observation and when it ends.",
    factory="core.environments.mjcf.environment:make",
    observation_size=None,
    action_size=None,
    dt=None,
    episode_length=1000,
    tracked_body="",
    options=MjcfOptions,
    takes_model=True,
    vary=varied,
    free_in_rollouts=("terrain",),
    curriculum_option="terrain/curriculum",
    on_a_cpu=(
        Rule(
            "compiled",
            64,
            "With 64 environments it was faster than native for every body that was measured (`own_models`).",
        ),
    ),
    on_a_gpu=(
        Rule(
            "compiled",
            1,
            "On an H200 it was 3 to 100 times as fast as warp for every measured body of such a size "
            "(`gpu_own_models`).",
            most=BodySize(num_dofs=30, num_pairs=50),
        ),
        Rule(
            "compiled",
            1024,
            "On an H200 it was 2.2 to 3.5 times as fast as warp for five robots of 18 degrees of freedom, "
            "133 to 581 pairs of geoms.",
            most=BodySize(num_dofs=20, num_pairs=600),
        ),
        Rule(
            "compiled",
            1024,
            "On an H200 it was 1.6 times as fast as warp for dm_control's humanoid (27 degrees of freedom, "
            "161 pairs of geoms), and 0.8 times for a G1 (35, 502).",
            most=BodySize(num_dofs=30, num_pairs=200),
        ),
        Rule("warp", 1, "A larger body's code for compiled takes long to make and to run; warp is faster."),
    ),
)
