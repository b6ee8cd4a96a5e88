"""Why, and by which signals, a supervisor stops its training process.

They have a module of their own because the process handles them before it loads anything slow.
"""

import signal
from enum import StrEnum

# Finish the epoch, keep the work, make the video of how far it came, and exit.
STOP_SIGNAL = signal.SIGTERM
# The job continues elsewhere: keep a checkpoint, nothing else, and exit; at once if there is nothing new to
# keep. Sent repeatedly until the process ends.
DRAIN_SIGNAL = signal.SIGUSR1


class Stop(StrEnum):
    """The reason for which a training process was asked to stop."""

    CANCEL = "cancel"
    TIMEOUT = "timeout"
    DRAIN = "drain"
