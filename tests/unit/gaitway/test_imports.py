import subprocess
import sys

from core.jobs.status import JobStatus
from gaitway.schema import FINAL_STATUSES


def test_a_policy_without_the_numerical_stack_is_refused_with_what_to_install() -> None:
    code = (
        "import sys; from pathlib import Path; sys.modules['jax'] = None\n"
        "from gaitway import MissingExtra, policy\n"
        "try: policy.load(Path('x'), 'ppo', is_checkpoint=False)\n"
        "except MissingExtra as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'gaitway[policy]'" in done.stdout


def test_the_client_knows_which_statuses_are_final() -> None:
    assert {status.value for status in JobStatus if status.is_final} == FINAL_STATUSES
