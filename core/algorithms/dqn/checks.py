"""Which of DQN's hyperparameters go together, and with which environment."""

from core.algorithms.dqn.memory import num_parts
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.off_policy.checks import replay_refusal
from core.algorithms.q_learning.checks import problems_of_the_actions
from core.environments.info import Device, EnvironmentInfo
from core.errors import Rejected


def refusal(settings: DQNSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together, or not with this environment; None where they do."""
    problems = [
        *problems_of_the_actions(
            settings.action_set, environment, "the network has an output for each choice"
        ),
        *settings.epsilon.problems(settings.num_actions),
    ]
    if problems:
        return Rejected(" ".join(problem.detail for problem in problems), problems)
    return replay_refusal(settings, environment, num_parts(settings, environment))
